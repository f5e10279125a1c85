"""`localiser camera`: calibrate the lens, find tilt and roll."""
