"""The motion model of a wheeled robot: rotation, translation, rotation [Thrun, Burgard, Fox 2005, table 5.6].

The noise grows with the path, as in a random walk, so it does not depend on how the path is divided: variances add up
over a chain of increments. The parameters have AMCL's names. AMCL's own are per step of a filter with a fixed rate;
these are per metre and per radian.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from pydantic import Field

from localiser.geometry import Array, Increment, cos_sin, wrap_angle
from localiser.geometry.compiled import compiled
from localiser.motion.constant_errors import (
    CONSTANT_ERRORS,
    ConstantErrorParameters,
    StepSpread,
    at_start,
    forgotten,
    projected,
    with_constant_errors,
)
from localiser.particles import CAMERA_YAW, Particles

SLIP = 0.1  # sigma of slipping sideways, as a share of that along the way: no wheel is quite true


@dataclass(frozen=True, slots=True)
class MotionParameters:
    """How good the odometry is. Each is a variance per unit of path: double the path, double the variance."""

    alpha1: Annotated[float, Field(ge=0, description="heading variance from turning (rad² per rad)")] = 1.2e-3
    alpha2: Annotated[float, Field(ge=0, description="heading variance from driving (rad² per m)")] = 7e-4
    alpha3: Annotated[float, Field(ge=0, description="distance variance from driving (m² per m)")] = 9e-4
    alpha4: Annotated[float, Field(ge=0, description="distance variance from turning (m² per rad)")] = 1e-4
    bias: ConstantErrorParameters = field(default_factory=ConstantErrorParameters)

    # The model with these parameters, as `MotionModel` and `LinearisedMotion` ask for it.

    @property
    def delay_sigma_s(self) -> float:
        """By how much the robot may be later than its odometry, one sigma."""
        return self.bias.delay_sigma_s

    def predict(self, particles: Particles, increment: Increment, rng: np.random.Generator) -> Particles:
        """Return the particles moved by `increment`, each with its own draw of the noise."""
        step = self.expected_step(particles, increment)
        return self.stepped(particles, step, rng.standard_normal(step.expected.shape), increment)

    def expected_step(self, particles: Particles, increment: Increment) -> Step:
        """Return how particles move by `increment`, each by what it knows of the constant errors.

        Half of the turn's noise comes before the translation and half after it, so that heading and sideways error are
        correlated as on a wheeled robot [Thrun, Burgard, Fox 2005, table 5.6]. An increment that knows its own
        covariance (vision) errs by a draw from that instead, and tells nothing of them.
        """
        ahead_m, _, noise, effects = _step_of(increment, self)
        none = np.zeros(3)
        effect = dict(zip(CONSTANT_ERRORS, effects, strict=True))
        by_constant_error = np.array([effect.get(name, none) for name in particles.names[3:]]).reshape(-1, 3).T
        cov = by_constant_error @ particles.constant_error_cov @ by_constant_error.T + noise
        variance, axes = np.linalg.eigh(cov)
        start = particles.columns[:3].copy()
        if CAMERA_YAW in particles.names:
            start[2] += particles[CAMERA_YAW]  # of the camera, by which the constant errors are seen
        cos, sin = cos_sin(start[2] + direction_of_travel(increment))
        expected = by_constant_error @ particles.columns[3:]
        expected += np.array([[ahead_m], [0.0], [increment.mean[2]]])
        return Step(start, cos, sin, expected, by_constant_error, StepSpread(axes, variance))

    def stepped(self, particles: Particles, step: Step, normal: Array, increment: Increment) -> Particles:
        """Return the particles after steps drawn as `normal` (3, N), and what these told of the constant errors.

        normal is the step standardised: S^(-½) (step - H m), m being a particle's mean of the constant errors and
        S = H P Hᵀ + noise. Both mean and covariance P of these are updated by it as by a measurement.
        """
        columns = np.empty_like(particles.columns, order="C")
        compiled(step_loop)(step.start, step.cos, step.sin, step.expected, step.spread.root, normal, columns)
        gain = particles.constant_error_cov @ step.by_constant_error.T @ step.spread.whitened
        columns[3:] = particles.columns[3:] + gain @ normal
        if CAMERA_YAW in particles.names:
            columns[2] -= columns[particles.names.index(CAMERA_YAW)]
        columns[2] = wrap_angle(columns[2])
        moved = replace(particles, columns=columns, constant_error_cov=particles.constant_error_cov - gain @ gain.T)
        return forgotten(projected(moved) if step.by_constant_error.any() else moved, increment.path_m, self.bias)

    def covariance(self, increment: Increment) -> Array:
        """Return the covariance (3, 3) of wheels' motion in the robot frame, with the prior of the constant errors."""
        _, from_robot, noise, effects = _step_of(increment, self)
        by_constant_error = effects[:-1].T  # the camera's yaw moves no robot
        doubt = by_constant_error @ self.bias.cov[:-1, :-1] @ by_constant_error.T
        return np.asarray(from_robot.T @ (noise + doubt) @ from_robot)

    def at_start(self, particles: Particles, rng: np.random.Generator) -> Particles:
        """See `constant_errors.at_start`."""
        return at_start(particles, self.bias, rng)

    def with_constant_errors(self, particles: Particles) -> Particles:
        """See `constant_errors.with_constant_errors`."""
        return with_constant_errors(particles, self.bias)


def noise_variances(increment: Increment, parameters: MotionParameters) -> tuple[float, float]:
    """Return the variances (m², rad²) of the distance driven and of the turn made during `increment`.

    Both are 0 for an increment that knows its own covariance.
    """
    if increment.cov.any():
        return 0.0, 0.0
    path, turned = increment.path_m, increment.turned_rad
    distance = parameters.alpha3 * path + parameters.alpha4 * turned
    turn = parameters.alpha1 * turned + parameters.alpha2 * path
    return distance, turn


@lru_cache(maxsize=64)  # asked for many times in a step, each time by arrays of a single number
def direction_of_travel(increment: Increment) -> float:
    """Return the angle (rad) from the robot's forward axis, anticlockwise, along which distance noise acts.

    The chord of the motion, as a line: forward and backward count alike; straight ahead when the robot stood.
    """
    right, backward = increment.mean[:2]
    if np.hypot(right, backward) < 1e-9:
        return float(increment.mean[2] / 2)
    angle = np.arctan2(-right, -backward)
    return float((angle + np.pi / 2) % np.pi - np.pi / 2)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """How N particles are about to move.

    start: (3, N) poses, with the camera's heading. cos, sin: (N,) of the directions of travel. expected: (3, N) steps
    (along, left, turn). by_constant_error: (3, B), their derivatives.
    """

    start: Array
    cos: Array
    sin: Array
    expected: Array
    by_constant_error: Array
    spread: StepSpread

    @property
    def poses(self) -> Array:
        """Where (3, N) the steps that are expected lead."""
        return self.start + _in_map(self.expected, self.cos, self.sin)

    @property
    def axes(self) -> Array:
        """Derivatives (3, 3, N) of the poses by the standardised step, which is three standard normal draws."""
        return _in_map(self.spread.root[..., None], self.cos, self.sin)


@lru_cache(maxsize=64)  # of one motion asked for several times in a step
def _step_of(increment: Increment, parameters: MotionParameters) -> tuple[float, Array, Array, Array]:
    """Return length, rotation (3, 3) from the robot frame, noise (3, 3) and derivatives (5, 3) of a step.

    A step is (along the way m, to its left m, turn rad), along the chord of the motion, negative when backward. Half of
    the turn comes before the translation, which the camera's own yaw turns the other way. Derivatives are by
    `CONSTANT_ERRORS`, of which an increment that wheels alone did not measure tells nothing.
    """
    from_robot, turn = _map_from_step(0.0, increment).T, float(increment.mean[2])
    ahead_m = float(increment.mean[:2] @ from_robot[0, :2])
    distance_var, turn_var = noise_variances(increment, parameters)
    noise = np.diag([distance_var, SLIP**2 * distance_var + ahead_m**2 * turn_var / 2, turn_var])
    noise[1, 2] = noise[2, 1] = ahead_m * turn_var / 2
    if increment.cov.any():
        noise = np.asarray(noise + from_robot @ increment.cov @ from_robot.T)
        return ahead_m, from_robot, noise, np.zeros((len(CONSTANT_ERRORS), 3))
    effects = [
        (ahead_m, 0.0, 0.0),  # of the scale of distances
        (0.0, ahead_m * turn / 2, turn),  # of turns
        (0.0, ahead_m * ahead_m / 2, ahead_m),  # of the veer
        from_robot @ increment.by_delay,
        (0.0, -ahead_m, 0.0),  # of the camera's yaw
    ]
    return ahead_m, from_robot, noise, np.array(effects)


def linearised(pose: Array, increment: Increment, parameters: MotionParameters) -> tuple[Array, Array]:
    """Return F = ∂(next pose)/∂(pose) and Q, the covariance of the noise, both (3, 3) in the map, at `pose` (3,).

    The first-order form of `predict` where no constant error is in doubt, for the posterior Cramér-Rao bound.
    """
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    right, backward = increment.mean[:2]
    jac_pose = np.eye(3)
    jac_pose[:2, 2] = [-sin * right + cos * backward, -cos * right - sin * backward]
    to_map = _map_from_step(float(pose[2]), increment)
    return jac_pose, np.asarray(to_map @ _step_of(increment, parameters)[2] @ to_map.T)


def _in_map(steps: Array, cos: Array, sin: Array) -> Array:
    """Return (x, z, heading) (3, ..., N) of (along, left, turn) (3, ..., N or 1) by directions of travel (N,)."""
    along, left, turn = steps
    moved = np.empty((3, *np.broadcast_shapes(along.shape, cos.shape)))
    moved[0] = -sin * along - cos * left
    moved[1] = sin * left - cos * along
    moved[2] = turn
    return moved


def _map_from_step(heading: float, increment: Increment) -> Array:
    """Return the rotation (3, 3) from (along, left, turn) to (x, z, heading) of the map; of the robot for 0."""
    way = heading + direction_of_travel(increment)
    cos, sin = np.cos(way), np.sin(way)
    return np.array([[-sin, -cos, 0.0], [-cos, sin, 0.0], [0.0, 0.0, 1.0]])


def step_loop(start: Array, cos: Array, sin: Array, expected: Array, root: Array, normal: Array, end: Array) -> None:
    """Write the poses of N particles after a step into the first three rows of `end` (D, N).

    start: (3, N) poses. cos, sin: (N,) of the directions of travel. expected: (3, N) steps (along, left, turn). root:
    (3, 3), by which standard normal draws (3, N) become what a step differs from that.
    """
    for n in range(len(cos)):
        along, left, turn = expected[0, n], expected[1, n], expected[2, n]
        x, z, turned = 0.0, 0.0, 0.0  # by what is drawn
        for k in range(3):
            x += (-sin[n] * root[0, k] - cos[n] * root[1, k]) * normal[k, n]
            z += (sin[n] * root[1, k] - cos[n] * root[0, k]) * normal[k, n]
            turned += root[2, k] * normal[k, n]
        end[0, n] = start[0, n] + (-sin[n] * along - cos[n] * left) + x
        end[1, n] = start[1, n] + (sin[n] * left - cos[n] * along) + z
        end[2, n] = start[2, n] + turn + turned


# -- what the filter asks of a motion model ---------------------------------------------------------------------------


@runtime_checkable
class MotionModel(Protocol):
    """Anything that moves particles by an increment."""

    def predict(self, particles: Particles, increment: Increment, rng: np.random.Generator) -> Particles:
        """Return the particles moved by `increment`, each with its own draw of the noise."""
        ...


@runtime_checkable
class LinearisedMotion(MotionModel, Protocol):
    """A model whose noise is normal, and whose particles carry constant errors of wheels and mount in own columns.

    So the optimal proposal can draw steps from odometry and edges together, and vision knows how certain wheels are.
    """

    @property
    def delay_sigma_s(self) -> float:
        """By how much the robot may be later than its odometry, one sigma."""
        ...

    def expected_step(self, particles: Particles, increment: Increment) -> Step:
        """Return where particles are expected, and the derivatives of that by the standardised step."""
        ...

    def stepped(self, particles: Particles, step: Step, normal: Array, increment: Increment) -> Particles:
        """Return the particles after standardised steps (3, N)."""
        ...

    def covariance(self, increment: Increment) -> Array:
        """Return the covariance (3, 3) of a motion in the robot frame, constant errors included."""
        ...

    def at_start(self, particles: Particles, rng: np.random.Generator) -> Particles:
        """Return particles of stated robot poses with the columns of the constant errors."""
        ...

    def with_constant_errors(self, particles: Particles) -> Particles:
        """Return particles of poses that a camera was found at with the columns of the constant errors."""
        ...


def covariance_of(model: MotionModel, increment: Increment) -> Array:
    """Return the covariance (3, 3) of a motion as the model has it, else as the increment states it."""
    covariance = getattr(model, "covariance", None)  # faster than to ask for the whole protocol
    return increment.cov if covariance is None else np.asarray(covariance(increment))
