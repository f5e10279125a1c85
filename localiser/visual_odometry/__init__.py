"""Visual odometry: how the robot moved between two images, by their edges [Taylor06, sec. 3]."""

from localiser.visual_odometry.estimate import Belief, Followed, Frames, Gaussian, follow, motion_gaussian
from localiser.visual_odometry.odometer import (
    Odometer,
    VisualOdometryParameters,
    seen_increment,
    twist_of_wheels,
    with_scale,
)
