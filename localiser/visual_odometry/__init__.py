"""Edges of two frames → how the robot moved between them ([Taylor06] section 3), alone or together with wheels."""

from localiser.visual_odometry.estimate import Belief, Followed, Frames, follow
from localiser.visual_odometry.odometer import Odometer
from localiser.visual_odometry.parameters import VisualOdometryParameters
from localiser.visual_odometry.twist import Gaussian

__all__ = ["Belief", "Followed", "Frames", "Gaussian", "Odometer", "VisualOdometryParameters", "follow"]
