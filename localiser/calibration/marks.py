"""True poses of a drive over surveyed marks: odometry between the marks, corrected so that it meets them.

The robot stood on marks whose places were measured, at times that are known. Between two marks its odometry tells how
it moved, with the noise of the motion model and three constant errors b: the scale of the distance, the scale of turns,
and the veer. Poses and constant errors are one Gaussian smoothing problem, solved by an extended Kalman filter and the
smoother of Rauch, Tung and Striebel, linearised anew about its own result until that stays the same:

    x_{k+1} = x_k ⊕ ((1 + b₁) dx, (1 + b₁) dz, (1 + b₂) turn + b₃ path) + noise,    z_j = x_{k(j)} + noise

A mark that the others contradict is told by the residual that it would have if the poses were found without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from localiser.errors import InputError
from localiser.geometry import Array, Increment, Trajectory, between, compose, wrap_angle
from localiser.motion import EXACT, MotionParameters, linearised

MARK_SIGMA_M, MARK_SIGMA_RAD = 0.01, np.deg2rad(2.0)
"""How far a robot stands beside its mark, and off a heading that is stated, one sigma, where nothing is said of it."""
CONTRADICTED_SIGMAS = 5.0
_NODE_M, _NODE_RAD = 0.05, np.deg2rad(2.0)  # a pose of its own in the problem from this motion on
_APART_M = 0.3  # marks nearer than this tell no heading
_ANYWHERE = np.array([1e2, 1e2, 1e1])  # sigma before any mark
_ROUNDS, _SMALL_M = 8, 1e-4


@dataclass(frozen=True, slots=True)
class Mark:
    """Where the robot stood at a time (ns): metres, and the heading in radians, nan where it was not measured."""

    t_ns: int
    x_m: float
    z_m: float
    heading_rad: float = np.nan
    sigma_m: float = MARK_SIGMA_M
    sigma_rad: float = MARK_SIGMA_RAD

    @property
    def place(self) -> Array:
        """What was measured (3,)."""
        return np.array([self.x_m, self.z_m, self.heading_rad])


@dataclass(frozen=True, slots=True, eq=False)
class MarkedDrive:
    """The poses of a drive over marks, from the first of them to the last.

    covs: (T, 3, 3) of the poses. constants, sigmas: (3,) what the odometry lacked: distance and turn (shares), veer
    (rad/m). left_out: (M,) in sigmas, how far each mark is from where all others put it.
    """

    trajectory: Trajectory
    covs: Array
    constants: Array
    sigmas: Array
    left_out: Array

    @property
    def position_sigma_m(self) -> Array:
        """Root of the trace of the position's covariance (T,)."""
        return np.asarray(np.sqrt(np.trace(self.covs[:, :2, :2], axis1=1, axis2=2)))


def drive_over_marks(
    odometry: Trajectory, marks: Sequence[Mark], motion: MotionParameters | None = None
) -> MarkedDrive:
    """Return the poses of a drive, from its odometry in a frame of its own and the marks in the order of time.

    Raises InputError for fewer than two marks, marks outside the odometry's time or not in order, marks at one place
    without a heading, and a mark that the others contradict. Its `line` is the number of the mark from 1.
    """
    motion = motion or MotionParameters()
    _check(odometry, marks)
    nodes = _nodes(odometry, marks)
    problem = _Problem.of(odometry, nodes, marks, motion)
    states, covs = problem.solved()
    left_out = problem.left_out(states, covs)
    worst = int(np.argmax(left_out))
    if left_out[worst] > CONTRADICTED_SIGMAS:
        raise InputError(
            f"expected a mark within {CONTRADICTED_SIGMAS:.0f} sigma of where odometry and the other marks put the "
            f"robot, found one {left_out[worst]:.1f} sigma away: is it another mark, or another time?",
            line=worst + 1,
        )
    return MarkedDrive(
        *_between_nodes(odometry, nodes, states, covs), states[-1, 3:], np.sqrt(np.diag(covs[-1]))[3:], left_out
    )


def _check(odometry: Trajectory, marks: Sequence[Mark]) -> None:
    if len(marks) < 2:
        raise InputError(f"expected at least two marks, found {len(marks)}")
    for number, mark in enumerate(marks, start=1):
        if not odometry.covers(mark.t_ns):
            span = f"{odometry.t_ns[0]} to {odometry.t_ns[-1]} ns" if len(odometry) else "none"
            raise InputError(
                f"expected a time of the odometry ({span}), found {mark.t_ns} ns", line=number, field="time"
            )
        if number > 1 and mark.t_ns <= marks[number - 2].t_ns:
            raise InputError(
                f"expected a time after {marks[number - 2].t_ns} ns, found {mark.t_ns} ns", line=number, field="time"
            )
    places = np.array([mark.place for mark in marks])
    apart = _apart(places)
    if apart < _APART_M and np.isnan(places[:, 2]).all():
        raise InputError(
            f"expected marks at least {_APART_M} m apart, or a heading at one of them, found all within {apart:.2f} m"
        )


def _nodes(odometry: Trajectory, marks: Sequence[Mark]) -> Trajectory:
    """Return the odometry at the marks, and between them wherever the robot has moved a little."""
    inside = (odometry.t_ns >= marks[0].t_ns) & (odometry.t_ns <= marks[-1].t_ns)
    poses, kept, last = odometry.poses, [], odometry.at(marks[0].t_ns)
    for index in np.flatnonzero(inside):
        moved = np.hypot(*(poses[index, :2] - last[:2]))
        if moved >= _NODE_M or abs(wrap_angle(poses[index, 2] - last[2])) >= _NODE_RAD:
            kept.append(int(odometry.t_ns[index]))
            last = poses[index]
    return odometry.sampled(np.unique([*kept, *(mark.t_ns for mark in marks)]))


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """K poses, the motions between them by odometry, and the marks at `at` (M,) of them.

    State: x, z, heading (not wrapped), and the three constant errors.
    """

    moves: list[Increment]
    marks: Sequence[Mark]
    at: list[int]
    noise: MotionParameters
    prior: Array
    start: Array

    @classmethod
    def of(cls, odometry: Trajectory, nodes: Trajectory, marks: Sequence[Mark], motion: MotionParameters) -> _Problem:
        at = [int(index) for index in np.searchsorted(nodes.t_ns, [mark.t_ns for mark in marks])]
        moves = [Increment.from_mean(move) for move in between(nodes.poses[:-1], nodes.poses[1:])]
        start = compose(_aligned(nodes.poses[at], marks), between(nodes.poses[at[0]], nodes.poses[0]))
        prior = np.concatenate([_ANYWHERE**2, np.diag(motion.bias.cov)[:3]])
        return cls(moves, marks, at, replace(motion, bias=EXACT), np.diag(prior), start)

    def solved(self) -> tuple[Array, Array]:
        """Return the states (K, 6) and covariances (K, 6, 6), each by all marks."""
        states = self._driven(np.concatenate([self.start, np.zeros(3)]))
        for _ in range(_ROUNDS):
            before, (states, covs) = states, self._smoothed(states)
            if np.abs(states - before)[:, :2].max() < _SMALL_M:
                break
        return states, covs

    def left_out(self, states: Array, covs: Array) -> Array:
        """Return how many sigmas (M,) each mark is from where the rest puts the robot: r' (R - P)⁻¹ r."""
        off = []
        for mark, k in zip(self.marks, self.at, strict=True):
            residual, observed, noise = _against(mark, states[k])
            rest = noise - observed @ covs[k] @ observed.T
            variance, axes = np.linalg.eigh((rest + rest.T) / 2)
            told = variance > 1e-6 * np.diag(noise).max()  # a direction that no other mark tells cannot contradict
            along = (axes.T @ residual)[told]
            off.append(float(np.sqrt((along**2 / variance[told]).sum())))
        return np.array(off)

    def _driven(self, state: Array) -> Array:
        states = [state]
        for move in self.moves:
            states.append(_moved(states[-1], move))
        return np.array(states)

    def _smoothed(self, about: Array) -> tuple[Array, Array]:
        """Return states (K, 6) and covariances (K, 6, 6), with motions and noise linearised about states (K, 6)."""
        mean, cov = np.concatenate([self.start, np.zeros(3)]), self.prior
        means, covs, steps = [], [], []
        marked = dict(zip(self.at, self.marks, strict=True))
        for k in range(len(about)):
            if k in marked:
                mean, cov = _updated(mean, cov, marked[k])
            means.append(mean)
            covs.append(cov)
            if k < len(self.moves):
                by_state, noise = self._linearised(about[k], self.moves[k])
                mean = _moved(about[k], self.moves[k]) + by_state @ (mean - about[k])
                cov = by_state @ cov @ by_state.T + noise
                steps.append((by_state, mean, cov))
        for k in range(len(means) - 2, -1, -1):
            by_state, expected, expected_cov = steps[k]
            gain = np.linalg.solve(expected_cov + 1e-15 * np.eye(6), by_state @ covs[k]).T
            means[k] = means[k] + gain @ (means[k + 1] - expected)
            covs[k] = covs[k] + gain @ (covs[k + 1] - expected_cov) @ gain.T
        return np.array(means), np.array(covs)

    def _linearised(self, state: Array, move: Increment) -> tuple[Array, Array]:
        corrected = replace(move, mean=_corrected(move, state[3:]))
        by_pose, pose_noise = linearised(state[:3], corrected, self.noise)
        cos, sin = np.cos(state[2]), np.sin(state[2])
        to_map = np.array([[cos, sin], [-sin, cos]])
        by_state, noise = np.eye(6), np.zeros((6, 6))
        by_state[:3, :3], noise[:3, :3] = by_pose, pose_noise
        by_state[:2, 3] = to_map @ move.mean[:2]
        by_state[2, 4:] = move.mean[2], _path(move)
        return by_state, noise


def _aligned(seen: Array, marks: Sequence[Mark]) -> Array:
    """Return the pose (3,) at the first mark that turns the odometry at the marks (M, 3) best onto them."""
    places = np.array([mark.place for mark in marks])
    known = np.isfinite(places[:, 2])
    one, other = seen[:, :2] - seen[:, :2].mean(axis=0), places[:, :2] - places[:, :2].mean(axis=0)
    if _apart(places) >= _APART_M:
        # Our headings turn x towards -z.
        turn = np.arctan2((one[:, 1] * other[:, 0] - one[:, 0] * other[:, 1]).sum(), (one * other).sum())
    else:
        off = places[known, 2] - seen[known, 2]
        turn = np.arctan2(np.sin(off).sum(), np.cos(off).sum())
    return np.array([*places[0, :2], seen[0, 2] + turn])


def _apart(places: Array) -> float:
    """Return how far from the first of the places (M, 3) the farthest one is (m)."""
    return float(np.hypot(*(places[:, :2] - places[0, :2]).T).max())


def _path(move: Increment) -> float:
    """Return the way driven, negative when backward, as veer counts it."""
    return -move.path_m if move.mean[1] > 0 else move.path_m


def _corrected(move: Increment, constants: Array) -> Array:
    distance, turn, veer = constants
    return np.array([*((1 + distance) * move.mean[:2]), (1 + turn) * move.mean[2] + veer * _path(move)])


def _moved(state: Array, move: Increment) -> Array:
    """Return the state (6,) after a motion; the heading is not wrapped."""
    motion = _corrected(move, state[3:])
    at = compose(state[:3], motion)
    return np.array([*at[:2], state[2] + motion[2], *state[3:]])


def _against(mark: Mark, state: Array) -> tuple[Array, Array, Array]:
    """Return a mark less the state (D,), what it observes of it (D, 6), and its covariance (D, D)."""
    known = 3 if np.isfinite(mark.heading_rad) else 2
    residual = mark.place - state[:3]
    residual[2] = wrap_angle(residual[2]) if known == 3 else 0.0
    noise = np.diag(np.square([mark.sigma_m, mark.sigma_m, mark.sigma_rad]))
    return residual[:known], np.eye(6)[:known], noise[:known, :known]


def _updated(mean: Array, cov: Array, mark: Mark) -> tuple[Array, Array]:
    residual, observed, noise = _against(mark, mean)
    gain = np.linalg.solve(observed @ cov @ observed.T + noise, observed @ cov).T
    kept = np.eye(6) - gain @ observed  # Joseph's form stays positive from a prior that knows nothing
    return mean + gain @ residual, kept @ cov @ kept.T + gain @ noise @ gain.T


def _between_nodes(odometry: Trajectory, nodes: Trajectory, states: Array, covs: Array) -> tuple[Trajectory, Array]:
    """Return poses and covariances at all times of the odometry too; from a node on it is right for a little."""
    inside = (odometry.t_ns > nodes.t_ns[0]) & (odometry.t_ns < nodes.t_ns[-1])
    t_ns = np.unique(np.concatenate([nodes.t_ns, odometry.t_ns[inside]]))
    node = np.searchsorted(nodes.t_ns, t_ns, side="right") - 1
    since = between(nodes.poses[node], odometry.sampled(t_ns).poses)
    poses = compose(states[node, :3], since)
    return Trajectory(t_ns, poses), covs[node, :3, :3]
