"""Factors of the SLAM problem: residuals of wheels, bearings and priors, and their derivatives, as arrays.

Every residual is measured minus predicted, in sigmas. Variables: poses but the first, constants, landmarks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from localiser.geometry import Array, between, robot_from_map, wrap_angle
from localiser.mapping.sightings import Index
from localiser.mapping.sparse import Block, Linearised
from localiser.motion import MotionParameters

CONSTANTS = ("distance scale", "rotation scale", "veer", "mount yaw")
_CAUCHY = 2.0
_PLACE_SIGMA_M = 10.0
_LEAST_SIGMA = 1e-6  # of a constant that is stated to be exact


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is known of the constants beforehand: mean (4,) and sigma (4,)."""

    mean: Array
    sigma: Array

    @classmethod
    def of(cls, motion: MotionParameters) -> Prior:
        """Return the prior that the motion model states, the same as in the filter."""
        stated = motion.bias
        veer, yaw = np.deg2rad([stated.veer_sigma_deg_per_m, stated.yaw_sigma_deg])
        sigma = np.array([stated.distance_sigma, stated.turn_sigma, veer, yaw])
        return cls(np.zeros(len(CONSTANTS)), np.maximum(sigma, _LEAST_SIGMA))


@dataclass(frozen=True, eq=False)
class Steps:
    """Odometry between consecutive frames: motion (T - 1, 3) in the robot frame, and the path driven (T - 1,).

    path_m: negative for driving backwards. cov: (T - 1, 3, 3) of the noise of each motion.
    """

    motion: Array
    path_m: Array
    cov: Array

    @cached_property
    def whitening(self) -> Array:
        """W (T - 1, 3, 3) with W cov Wᵀ = 1: residuals times W are in sigmas, and independent."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.cov)))

    @property
    def turn_sigma(self) -> Array:
        """The sigma (T - 1,) rad of each turn."""
        return np.sqrt(self.cov[:, 2, 2])


@dataclass(frozen=True, slots=True, eq=False)
class Bearings:
    """Bearings (K,): frame, landmark, bearing and sigma (rad), all (K,)."""

    frame: Index
    landmark: Index
    bearing: Array
    sigma: Array


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What is measured, T frames. robot_from_level: (T, 3) floor poses of the camera in the robot frame, as stated."""

    wheels: Steps
    bearings: Bearings
    robot_from_level: Array
    prior: Prior


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What is believed: poses (T, 3), landmarks (L, 2), constants (4,), and where landmarks started (L, 2)."""

    poses: Array
    points: Array
    constants: Array
    start: Array

    def moved(self, step: Array) -> State:
        """Return the state after a step: poses without the first, constants, landmarks."""
        poses = self.poses.copy()
        free = 3 * (len(poses) - 1)
        poses[1:] += step[:free].reshape(-1, 3)
        poses[:, 2] = wrap_angle(poses[:, 2])
        constants = self.constants + step[free : free + len(CONSTANTS)]
        points = self.points + step[free + len(CONSTANTS) :].reshape(-1, 2)
        return State(poses, points, constants, self.start)


# -- residuals, each measured minus predicted, in sigmas ---------------------------------------------------------------


def wheel_residuals(wheels: Steps, poses: Array, constants: Array) -> Array:
    """Return what the wheels say minus what they should (T - 1, 3) in sigmas, given what is wrong with them.

    poses: (T, 3). constants: (4,), see `CONSTANTS`. The constants act on the motion, not on the measurement: else the
    best scale would be 0, where noise is too.
    """
    moved = between(poses[:-1], poses[1:]) * _scales(constants)
    residual = wheels.motion - moved
    residual[:, 2] = wrap_angle(residual[:, 2] - wheels.path_m * constants[2])
    return np.asarray(np.einsum("tij,tj->ti", wheels.whitening, residual))


def _scales(constants: Array) -> Array:
    return np.array([1 + constants[0], 1 + constants[0], 1 + constants[1]])


def _bearing_residual(problem: Problem, state: State) -> tuple[Array, Array]:
    """Return the residuals (K,), and the landmarks (K, 2) in the robot frames."""
    b = problem.bearings
    in_robot = robot_from_map(state.poses[b.frame], state.points[b.landmark])
    mount = problem.robot_from_level[b.frame] + np.array([0.0, 0.0, state.constants[3]])
    level = robot_from_map(mount, in_robot)
    return wrap_angle(b.bearing - np.arctan2(level[:, 0], -level[:, 1])) / b.sigma, in_robot


def cost_of(problem: Problem, state: State) -> float:
    """Return the robust cost that is to be made small."""

    plain = (wheel_residuals(problem.wheels, state.poses, state.constants) ** 2).sum() + (
        ((state.constants - problem.prior.mean) / problem.prior.sigma) ** 2
    ).sum()
    plain += (((state.start - state.points) / _PLACE_SIGMA_M) ** 2).sum()
    bearing = _bearing_residual(problem, state)[0]
    return float(plain) + float((_CAUCHY**2 * np.log1p((bearing / _CAUCHY) ** 2)).sum())


# -- linearisation ----------------------------------------------------------------------------------------------------


def linearise(problem: Problem, state: State) -> Linearised:
    """Return residuals, robust weights and derivatives of the predictions: bearings first, in their order.

    Variables: poses but the first, constants, landmarks. The gradient step solves (JᵀWJ) step = JᵀW r.
    """
    prior, first = problem.prior, _first_landmark(len(state.poses))
    constants = first - len(CONSTANTS) + np.arange(len(CONSTANTS))[:, None]
    known = _block([constants], [np.ones(constants.shape)], prior.sigma, (prior.mean - state.constants) / prior.sigma)
    # This keeps a landmark of hardly any parallax from running off: its place is known to some ten metres.
    places = first + np.arange(state.points.size)[:, None]
    away = (state.start - state.points).ravel() / _PLACE_SIGMA_M
    near = _block([places], [np.ones(places.shape)], np.full(len(away), _PLACE_SIGMA_M), away)
    return Linearised([bearing_block(problem, state), _wheel_block(problem, state), known, near], variables(state))


def variables(state: State) -> int:
    """Return the number of variables: poses but the first, constants, landmarks."""
    return _first_landmark(len(state.poses)) + state.points.size


def landmark_columns(frames: int, landmark: Index) -> Index:
    """Return the variables (K, 2) of landmarks (K,)."""
    return _first_landmark(frames) + 2 * landmark[:, None] + np.arange(2)


def _first_landmark(frames: int) -> int:
    return 3 * (frames - 1) + len(CONSTANTS)


def _block(columns: list[Index], values: list[Array], sigma: Array, residual: Array) -> Block:
    """Return measurements from columns (K, ·) and derivatives (K, ·) side by side, divided by sigma (K,)."""
    value = np.concatenate(values, axis=1) / sigma[:, None]
    return Block(np.concatenate(columns, axis=1), value, residual, np.ones(len(residual)))


def _pose_columns(frame: Index) -> Index:
    """Return the columns (K, 3) of a pose; negative for the first, which is fixed."""
    return np.where(frame[:, None] > 0, 3 * (frame[:, None] - 1) + np.arange(3), -1)


def _wheel_block(problem: Problem, state: State) -> Block:
    wheels, steps = problem.wheels, len(state.poses) - 1
    heading = state.poses[:-1, 2]
    cos, sin = np.cos(heading), np.sin(heading)
    moved = between(state.poses[:-1], state.poses[1:])
    zero, one = np.zeros(steps), np.ones(steps)
    # between = (R(h)ᵀ (p' - p), h' - h); d/dh of robot_from_map is (-z, x) of the result.
    start = np.array([[-cos, sin, -moved[:, 1]], [-sin, -cos, moved[:, 0]], [zero, zero, -one]]).transpose(2, 0, 1)
    end = np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]]).transpose(2, 0, 1)
    by_constant = np.zeros((steps, 3, 3))
    by_constant[:, 0, 0], by_constant[:, 1, 0] = moved[:, 0], moved[:, 1]
    by_constant[:, 2, 1], by_constant[:, 2, 2] = moved[:, 2], wheels.path_m
    scales = _scales(state.constants)[:, None]
    frame = np.repeat(np.arange(steps), 3)
    constant = np.tile(3 * steps + np.arange(3), (3 * steps, 1))
    columns = [_pose_columns(frame), _pose_columns(frame + 1), constant]
    by_all = wheels.whitening @ np.concatenate([scales * start, scales * end, by_constant], axis=2)
    residual = wheel_residuals(wheels, state.poses, state.constants).ravel()
    return _block(columns, [by_all.reshape(-1, 9)], np.ones(3 * steps), residual)


def bearing_block(problem: Problem, state: State) -> Block:
    """Return the bearings (K,) by pose, landmark and the mount's yaw: columns 0-2, 3-4 and 5 of (K, 6)."""
    b = problem.bearings
    residual, in_robot = _bearing_residual(problem, state)
    offset = in_robot - problem.robot_from_level[b.frame, :2]
    squared = np.maximum((offset**2).sum(axis=1), 1e-9)
    # Bearing from the robot's axis: atan2(x, -z), so d/d(x, z) = (-z, x) / r².
    by_point = np.stack([-offset[:, 1], offset[:, 0]], axis=-1) / squared[:, None]
    frames = len(state.poses)
    # A mount turned to the left sees everything farther to the right.
    yaw = np.full((len(residual), 1), 3 * (frames - 1) + 3)
    columns = [_pose_columns(b.frame), landmark_columns(frames, b.landmark), yaw]
    heading = state.poses[b.frame, 2]
    cos, sin = np.cos(heading), np.sin(heading)
    # in_robot = (cos dx - sin dz, sin dx + cos dz).
    by_map = np.stack([by_point[:, 0] * cos + by_point[:, 1] * sin, -by_point[:, 0] * sin + by_point[:, 1] * cos], -1)
    by_heading = -by_point[:, 0] * in_robot[:, 1] + by_point[:, 1] * in_robot[:, 0]
    plain = _block(columns, [-by_map, by_heading[:, None], by_map, np.ones(yaw.shape)], b.sigma, residual)
    return replace(plain, weight=1 / (1 + (residual / _CAUCHY) ** 2))
