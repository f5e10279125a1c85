"""Motion models: predict particles from odometry, with its noise and its constant errors."""

from localiser.motion.constant_errors import EXACT
from localiser.motion.inertial import GRAVITY_M_S2, up_of
from localiser.motion.odometry_model import (
    SLIP,
    LinearisedMotion,
    MotionModel,
    MotionParameters,
    Step,
    covariance_of,
    direction_of_travel,
    linearised,
    noise_variances,
)
