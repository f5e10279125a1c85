"""Motion models: predict particles from odometry, with its noise and its constant errors."""

from localiser.motion.inertial import up_of
from localiser.motion.odometry_model import (
    EXACT,
    MotionModel,
    MotionParameters,
    Step,
    covariance_of,
    linearised,
    noise_variances,
)
