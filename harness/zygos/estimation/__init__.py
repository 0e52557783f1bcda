"""What surrounds the flight library in an estimate on the ground: watching a run, verdicts and remedies in words."""
