"""Visual odometry: how the robot moved between two images, by their edges [Taylor06, sec. 3]."""

from localiser.visual_odometry.estimate import Gaussian, follow, mixture
from localiser.visual_odometry.odometer import Odometer, VisualOdometryParameters, increment_of, with_scale
from localiser.visual_odometry.two_images import TwoImages
