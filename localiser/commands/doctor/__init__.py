"""`localiser doctor`: check whether installation, robot, camera and map fit together."""
