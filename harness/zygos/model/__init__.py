"""What is believed of an arm: bodies, base parameters, and the fit of bodies to parameters."""
