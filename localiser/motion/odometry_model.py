"""The motion model of a wheeled robot, and a Kalman filter for its constant errors inside every particle.

The model is rotation, translation, rotation [Thrun, Burgard, Fox 2005, table 5.6], with noise that grows with the path
(docs/motion.md).

Five errors of a robot stay constant while it drives. Given the path of the camera, they are observed through a linear
model with Gaussian noise, so they need not be sampled. A particle has their mean. Their covariance depends on the
odometry alone, so it is the same for all particles (Rao-Blackwell) [Doucet, de Freitas, Murphy, Russell 2000; Schön,
Gustafsson, Nordlund 2005].

    step = (along, left, turn) = odometry + H β + noise,    β = (distance_scale, turn_scale, veer, delay, camera_yaw)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Annotated, Protocol

import numpy as np
from pydantic import Field

from localiser.geometry import Array, Increment, cos_sin, wrap_angle, wrap_half_turn
from localiser.geometry.compiled import compiled
from localiser.particles import CAMERA_YAW, Particles, centred

CONSTANT_ERRORS = ("distance_scale", "turn_scale", "veer", "delay", CAMERA_YAW)
SLIP = 0.1  # sigma of slipping sideways, as a share of that along the way: no wheel is quite true


class MotionModel(Protocol):
    """Anything that moves particles by an increment."""

    def predict(self, particles: Particles, increment: Increment, rng: np.random.Generator) -> Particles:
        """Return the particles moved by `increment`, each with its own draw of the noise."""


@dataclass(frozen=True)
class ConstantErrorParameters:
    """How far wheels and mount may be wrong all the time (one sigma each); 0: not at all."""

    distance_sigma: Annotated[float, Field(ge=0, le=1, description="of the wheels' distance, as a share")] = 0.02
    turn_sigma: Annotated[float, Field(ge=0, le=1, description="of the wheels' turn, as a share")] = 0.03
    veer_sigma_deg_per_m: Annotated[
        float, Field(ge=0, le=90, description="turn of the robot while the wheels say straight on (degrees/m)")
    ] = 0.5
    delay_sigma_s: Annotated[float, Field(ge=0, le=1, description="delay of the robot behind its odometry (s)")] = 0.0
    yaw_sigma_deg: Annotated[float, Field(ge=0, le=90, description="of the camera's stated yaw (degrees)")] = 1.0
    memory_m: Annotated[
        float, Field(gt=0, description="way after which an estimate of them is forgotten: tyres, floors, loads (m)")
    ] = 500.0

    @cached_property
    def cov(self) -> Array:
        """Prior covariance (5, 5) of `CONSTANT_ERRORS`: shares, rad/m, s, rad."""
        veer, yaw = np.deg2rad([self.veer_sigma_deg_per_m, self.yaw_sigma_deg])
        return np.diag(np.square([self.distance_sigma, self.turn_sigma, veer, self.delay_sigma_s, yaw]))


EXACT = ConstantErrorParameters(0.0, 0.0, 0.0, 0.0, 0.0)  # of a robot without constant errors


@dataclass(frozen=True, slots=True)
class MotionParameters:
    """How good the odometry is. Each is a variance per unit of path: double the path, double the variance."""

    alpha1: Annotated[float, Field(ge=0, description="heading variance from turning (rad² per rad)")] = 1.2e-3
    alpha2: Annotated[float, Field(ge=0, description="heading variance from driving (rad² per m)")] = 7e-4
    alpha3: Annotated[float, Field(ge=0, description="distance variance from driving (m² per m)")] = 9e-4
    alpha4: Annotated[float, Field(ge=0, description="distance variance from turning (m² per rad)")] = 1e-4
    bias: ConstantErrorParameters = field(default_factory=ConstantErrorParameters)

    # The model with these parameters. Of any other one only `predict` is asked.

    def with_constant_errors(self, particles: Particles) -> Particles:
        """Return particles of poses that a camera was found at, with `CONSTANT_ERRORS` as the prior has them."""
        columns = np.concatenate([particles.columns, np.zeros((len(CONSTANT_ERRORS), len(particles)))])
        names = (*particles.names, *CONSTANT_ERRORS)
        return replace(particles, names=names, columns=columns, constant_error_cov=self.bias.cov.copy())

    def at_start(self, particles: Particles, rng: np.random.Generator) -> Particles:
        """Return particles of stated robot poses, with `CONSTANT_ERRORS` as the prior has them.

        Each pose becomes one of the camera by a draw of the yaw. What is then known of the yaw follows from how wide
        the headings were: all where they are certain, nothing where they go all around.
        """
        found, cloud = self.with_constant_errors(particles), particles.estimate
        yaw_var = self.bias.cov[-1, -1]
        share = yaw_var / max(yaw_var + cloud.cov[2, 2], 1e-300)
        camera_heading = particles["heading"] + np.sqrt(yaw_var) * rng.standard_normal(len(particles))
        found.columns[-1] = share * wrap_angle(camera_heading - cloud.mean[2])
        found.columns[2] = wrap_angle(camera_heading - found.columns[-1])
        found.constant_error_cov[-1, -1] *= 1 - share
        return found

    def predict(self, particles: Particles, increment: Increment, rng: np.random.Generator) -> Particles:
        """Return the particles moved by `increment`, each with its own draw of the noise."""
        step = self.expected_step(particles, increment)
        return self.stepped(particles, step, rng.standard_normal(step.expected.shape), increment)

    def expected_step(self, particles: Particles, increment: Increment) -> Step:
        """Return how particles move by `increment`, each by what it knows of the constant errors.

        Half of the turn's noise comes before the translation and half after it, so that heading and sideways error are
        correlated as on a wheeled robot [Thrun, Burgard, Fox 2005, table 5.6]. What vision told of an increment errs by
        a draw from its covariance, and tells nothing of them.
        """
        direction, ahead_m, noise, effects, _ = _step_of(increment, self)
        of_others = np.zeros((3, len(particles.constant_error_cov)))
        by_constant_error = effects.T if particles.names[3:] == CONSTANT_ERRORS else of_others
        cov = by_constant_error @ particles.constant_error_cov @ by_constant_error.T + noise
        variance, axes = np.linalg.eigh(cov)
        root = np.asarray(axes * np.sqrt(np.maximum(variance, 0.0)))
        whitened = np.asarray(axes / np.sqrt(np.where(variance > 1e-14 * variance[-1], variance, np.inf)))
        start = particles.columns[:3].copy()
        if CAMERA_YAW in particles.names:
            start[2] += particles[CAMERA_YAW]  # of the camera, by which the constant errors are seen
        cos, sin = cos_sin(start[2] + direction)
        expected = by_constant_error @ particles.columns[3:]
        expected[0] += ahead_m
        expected[2] += increment.mean[2]
        return Step(start, cos, sin, expected, by_constant_error, root, whitened)

    def stepped(self, particles: Particles, step: Step, normal: Array, increment: Increment) -> Particles:
        """Return the particles after steps drawn as `normal` (3, N), and what these told of the constant errors.

        normal is the step standardised: S^(-½) (step - H m), m being a particle's mean of the constant errors and
        S = H P Hᵀ + noise. Both mean and covariance P of these are updated by it as by a measurement.
        """
        columns = np.empty_like(particles.columns, order="C")
        compiled(step_loop)(step.start, step.cos, step.sin, step.expected, step.root, normal, columns)
        gain = particles.constant_error_cov @ step.by_constant_error.T @ step.whitened
        columns[3:] = particles.columns[3:] + gain @ normal
        cov = particles.constant_error_cov - gain @ gain.T
        if CAMERA_YAW in particles.names:
            columns[2] -= columns[-1]
        columns[2] = wrap_angle(columns[2])
        if step.by_constant_error.any():
            cov = at_most(cov + project(columns, particles.weight), self.bias.cov)
        if particles.names[3:] == CONSTANT_ERRORS and increment.path_m > 0:
            cov = forget(columns, cov, increment.path_m, self.bias)
        return replace(particles, columns=columns, constant_error_cov=cov)


@dataclass(frozen=True, eq=False)
class Step:
    """How N particles are about to move.

    start: (3, N) poses, with the camera's heading. cos, sin: (N,) of the directions of travel. expected: (3, N) steps
    (along, left, turn). by_constant_error: (3, B), their derivatives. root: S^½ (3, 3) of the covariance S = H P Hᵀ +
    noise; a step is its mean plus this times three standard normal draws. whitened: S^(-½) (3, 3), 0 along directions
    in which nothing can happen.
    """

    start: Array
    cos: Array
    sin: Array
    expected: Array
    by_constant_error: Array
    root: Array
    whitened: Array

    @cached_property
    def poses(self) -> Array:
        """Where (3, N) the steps that are expected lead."""
        return self.start + _in_map(self.expected, self.cos, self.sin)

    @cached_property
    def axes(self) -> Array:
        """Derivatives (3, 3, N) of the poses by the standardised step, which is three standard normal draws."""
        return _in_map(self.root[..., None], self.cos, self.sin)


def covariance_of(model: MotionModel, increment: Increment) -> Array:
    """Return the covariance (3, 3) of a motion in the robot frame: as wheels have it with the prior of their errors.

    As the increment states it where the model is another one.
    """
    return _step_of(increment, model)[-1] if isinstance(model, MotionParameters) else increment.cov


def noise_variances(increment: Increment, parameters: MotionParameters) -> tuple[float, float]:
    """Return the variances (m², rad²) of the distance and the turn that wheels measured."""
    path_m, turned_rad = increment.path_m - float(increment.told[0]), increment.turned_rad - float(increment.told[1])
    distance = parameters.alpha3 * path_m + parameters.alpha4 * turned_rad
    turn = parameters.alpha1 * turned_rad + parameters.alpha2 * path_m
    return distance, turn


def linearised(pose: Array, increment: Increment, parameters: MotionParameters) -> tuple[Array, Array]:
    """Return F = ∂(next pose)/∂(pose) and Q, the covariance of the noise, both (3, 3) in the map, at `pose` (3,).

    The first-order form of `predict` where no constant error is in doubt, for the posterior Cramér-Rao bound.
    """
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    right, backward = increment.mean[:2]
    jac_pose = np.eye(3)
    jac_pose[:2, 2] = [-sin * right + cos * backward, -cos * right - sin * backward]
    direction, _, noise, _, _ = _step_of(increment, parameters)
    to_map = _from_step(float(pose[2]) + direction)
    return jac_pose, np.asarray(to_map @ noise @ to_map.T)


@lru_cache(maxsize=64)  # of one motion asked for several times in a step
def _step_of(increment: Increment, parameters: MotionParameters) -> tuple[float, float, Array, Array, Array]:
    """Return direction, length, noise (3, 3) and derivatives (5, 3) of a step, and its covariance in the robot frame.

    A step is (along the way m, to its left m, turn rad), along the chord of the motion, negative when backward. Half of
    the turn comes before the translation, which the camera's own yaw turns the other way. Derivatives are by
    `CONSTANT_ERRORS`, of which what wheels did not measure tells nothing.
    """
    right, backward, turn = increment.mean.tolist()
    # As a line, forward and backward count alike; straight ahead when the robot stood.
    is_driven = math.hypot(right, backward) >= 1e-9
    direction = float(wrap_half_turn(np.arctan2(-right, -backward))) if is_driven else turn / 2
    from_robot = _from_step(direction).T
    ahead_m = float(increment.mean[:2] @ from_robot[0, :2])
    distance_var, turn_var = noise_variances(increment, parameters)
    left_var, left_turn = SLIP**2 * distance_var + ahead_m**2 * turn_var / 2, ahead_m * turn_var / 2
    noise = np.array([[distance_var, 0.0, 0.0], [0.0, left_var, left_turn], [0.0, left_turn, turn_var]])
    noise += from_robot @ increment.cov @ from_robot.T
    way = np.maximum([increment.path_m, increment.turned_rad], 1e-300)
    driven_m, turned = (np.array([ahead_m, turn]) * (1.0 - increment.told / way)).tolist()  # as wheels measured
    by_wheels = [
        (driven_m, 0.0, 0.0),  # of the scale of distances
        (0.0, ahead_m * turned / 2, turned),  # of turns
        (0.0, ahead_m * driven_m / 2, driven_m),  # of the veer
        from_robot @ increment.by_delay,
        (0.0, -driven_m, 0.0),  # of the camera's yaw
    ]
    effects = np.array(by_wheels)
    by_constant_error = effects[:-1].T  # the camera's yaw moves no robot
    doubt = by_constant_error @ parameters.bias.cov[:-1, :-1] @ by_constant_error.T
    return direction, ahead_m, noise, effects, np.asarray(from_robot.T @ (noise + doubt) @ from_robot)


def _from_step(way: float) -> Array:
    """Return the rotation (3, 3) from (along, left, turn) to (x, z, heading), the way being in this direction."""
    cos, sin = np.cos(way), np.sin(way)
    return np.array([[-sin, -cos, 0.0], [-cos, sin, 0.0], [0.0, 0.0, 1.0]])


def _in_map(steps: Array, cos: Array, sin: Array) -> Array:
    """Return (x, z, heading) (3, ..., N) of (along, left, turn) (3, ..., N or 1) by directions of travel (N,)."""
    along, left, turn = steps
    moved = np.empty((3, *np.broadcast_shapes(along.shape, cos.shape)))
    moved[0] = -sin * along - cos * left
    moved[1] = sin * left - cos * along
    moved[2] = turn
    return moved


def project(columns: Array, weight: Array) -> Array:
    """Make the constant errors of particles (D, N) linear in the camera's pose; return what is lost, a cov (B, B).

    That widens their covariance. Mean and covariance of poses and constant errors together stay as they are, so nothing
    is lost where they are normal. It keeps what is known of constants from depending on which of many past paths
    happened to survive resampling. weight: (N,) of sum 1.
    """
    _, residual = centred(columns, weight)
    residual[2] += residual[-1]
    pose = residual[:3]
    with_pose = (residual * weight) @ pose.T
    # In units of their spread, so that metres and radians are cut off alike.
    unit = np.sqrt(np.maximum(with_pose.diagonal(), 1e-300))
    variance, axes = np.linalg.eigh(with_pose[:3] / np.outer(unit, unit))
    axes /= np.sqrt(np.where(variance > 1e-9 * variance[-1], variance, np.inf)) * unit[:, None]
    change = with_pose[3:] @ (axes @ axes.T) @ pose - residual[3:]
    _add(columns, change)
    return np.asarray((change * weight) @ change.T)


def at_most(cov: Array, prior: Array) -> Array:
    """Return a covariance (B, B) whose variance exceeds that of a diagonal prior in no direction.

    What steps tell never puts constant errors in more doubt than before. What `project` adds may, where a likelihood
    has many peaks. Then doubt would feed itself: it lets steps be large, which tell of large errors.
    """
    sigma = np.sqrt(np.where(prior.diagonal() > 0, prior.diagonal(), 1.0))
    variance, axes = np.linalg.eigh(cov / np.outer(sigma, sigma))
    axes *= sigma[:, None]
    return np.asarray((axes * np.clip(variance, 0.0, 1.0)) @ axes.T) if variance[-1] > 1.0 else cov


def forget(columns: Array, cov: Array, path_m: float, parameters: ConstantErrorParameters) -> Array:
    """Let the constant errors of particles (D, N) drift on a way, an Ornstein-Uhlenbeck process; return their cov."""
    kept = np.exp(-path_m / parameters.memory_m)
    _add(columns, (kept - 1) * columns[3:])
    return np.asarray(kept**2 * cov + (1 - kept**2) * parameters.cov)


def _add(columns: Array, change: Array) -> None:
    """Change the constant errors (B, N) of particles (D, N), the camera's heading staying as it is."""
    columns[3:] += change
    columns[2] = wrap_angle(columns[2] - change[-1])


def step_loop(start: Array, cos: Array, sin: Array, expected: Array, root: Array, normal: Array, end: Array) -> None:
    """Write the poses of N particles after a step into the first three rows of `end` (D, N).

    normal: (3, N) standard normal draws, which times `root` (3, 3) are what a step differs from the `expected` one.
    The rest is as in `Step`.
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
