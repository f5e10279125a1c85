"""Motion models: predict particles from odometry, with its noise and its constant errors."""

from localiser.motion.constant_errors import CONSTANT_ERRORS, EXACT, ConstantErrorParameters
from localiser.motion.inertial import GRAVITY_M_S2, InertialNoise, up_of
from localiser.motion.odometry_model import (
    SLIP,
    MotionParameters,
    Step,
    direction_of_travel,
    expected_step,
    linearised,
    noise_variances,
    predict,
    step_noise,
    stepped,
    wheel_cov,
)
from localiser.motion.protocols import (
    EstimatesConstantErrors,
    LinearisedMotion,
    MotionCovariance,
    MotionModel,
    covariance_of,
)
