"""The arm of a run in three dimensions."""
