"""Visual odometry: how the robot moved between two images, by their edges [Taylor06, sec. 3]."""

from localiser.visual_odometry.estimate import Gaussian, follow, likely_twists, motion_gaussian, twist_gaussian
from localiser.visual_odometry.odometer import Odometer, VisualOdometryParameters, seen_increment, with_scale
from localiser.visual_odometry.two_images import TwoImages
