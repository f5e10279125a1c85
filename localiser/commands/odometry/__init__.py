"""`localiser odometry`: fit the noise and the constant errors of a robot's odometry to its logs."""
