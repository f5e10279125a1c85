"""Poses at times, and between them; odometry without its jumps; how fast a robot moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localiser.geometry.poses import Array, arc_log, arc_motion, between, compose, wrap_angle

FASTEST_M_S, FASTEST_RAD_S = 10.0, 20.0  # faster than any robot in a building
LEAST_JUMP_M, LEAST_JUMP_RAD = 0.3, 0.3  # below it may be noise of poses that follow each other at once


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses over time. t_ns: (T,) int64, strictly increasing. poses: (T, 3) x, z, heading."""

    t_ns: NDArray[np.int64]
    poses: Array

    def __len__(self) -> int:
        return len(self.t_ns)

    def covers(self, t_ns: int) -> bool:
        """Whether `t_ns` lies between the first and the last pose."""
        return len(self) > 0 and int(self.t_ns[0]) <= t_ns <= int(self.t_ns[-1])

    def at(self, t_ns: int) -> Array:
        """Return the pose (3,) at a time, interpolated along the arc; the first or last pose outside."""
        return np.asarray(self.sampled([t_ns]).poses[0])

    def sampled(self, times_ns: ArrayLike) -> Trajectory:
        """Return the trajectory at the given times (T',), interpolated along arcs; its first or last pose outside."""
        times, count = np.asarray(times_ns, dtype=np.int64), len(self.t_ns)
        if count == 1:
            return Trajectory(times, np.repeat(self.poses, len(times), axis=0))
        before = self.t_ns[1:-1].searchsorted(times)
        start, begin, end = self.poses[before], self.t_ns[before], self.t_ns[before + 1]
        fraction = np.minimum(np.maximum((times - begin) / (end - begin), 0.0), 1.0)
        motion = between(start, self.poses[before + 1])
        return Trajectory(times, compose(start, arc_motion(arc_log(motion), motion[:, 2] * fraction, fraction)))


def bridged(odometry: Trajectory) -> tuple[Trajectory, NDArray[np.int64]]:
    """Return poses of odometry without jumps, and the indices (J,) of the poses that are the first behind one.

    A base that restarts begins to count anew, so its pose jumps faster than any robot moves. There the robot is taken
    to have gone on as in the step before, or to have stood still where that is none or no robot's pace. Poses behind
    the jump are moved along.
    """
    raw, seconds = odometry.poses, np.diff(odometry.t_ns) / 1e9
    jumps: NDArray[np.int64] = np.flatnonzero(_jumps(between(raw[:-1], raw[1:]), seconds)) + 1
    if not len(jumps):
        return odometry, jumps
    poses = raw.copy()
    for jump, end in zip(jumps, [*jumps[1:], len(raw)], strict=True):
        step = np.zeros(3)
        if jump > 1:
            step = between(poses[jump - 2], poses[jump - 1]) * (seconds[jump - 1] / seconds[jump - 2])
        if _jumps(step, seconds[jump - 1]):  # of two poses that were stamped at nearly the same time
            step = np.zeros(3)
        poses[jump:end] = compose(compose(poses[jump - 1], step), between(raw[jump], raw[jump:end]))
    return Trajectory(odometry.t_ns, poses), jumps


def _jumps(steps: Array, seconds: ArrayLike) -> NDArray[np.bool_]:
    """Return which steps (..., 3) are faster than any robot moves."""
    way_m, turn_rad = np.hypot(steps[..., 0], steps[..., 1]), np.abs(wrap_angle(steps[..., 2]))
    far = way_m > np.maximum(FASTEST_M_S * np.asarray(seconds), LEAST_JUMP_M)
    return np.asarray(far | (turn_rad > np.maximum(FASTEST_RAD_S * np.asarray(seconds), LEAST_JUMP_RAD)))


WHEELS_SHARE = 0.05  # by which wheels may misjudge a turn, 1 sigma
USUAL_TURN_RAD_S = 0.5  # turn rate of a robot of which nothing is known, 1 sigma
MOST_SPEED_M_S, MOST_TURN_RAD_S = 5.0, 20.0  # faster than any robot indoors: wheels that say more count anew


@dataclass(frozen=True, slots=True)
class Twist:
    """Velocity in the robot's own frame: to the right and backward (m/s), turning anticlockwise (rad/s), its sigma."""

    right_m_s: float = 0.0
    backward_m_s: float = 0.0
    turn_rad_s: float = 0.0
    turn_sigma_rad_s: float = 0.0


UNKNOWN_TWIST = Twist(turn_sigma_rad_s=USUAL_TURN_RAD_S)


def twist_at(track: Trajectory, t_ns: int, span_s: tuple[float, float]) -> Twist:
    """Return the mean twist during a span (begin, end) about a time, by poses up to the first one at or after the time.

    A span that ends later is moved to end there: a running robot knows no later poses yet. The turn rate is as
    uncertain as wheels are, and as it has changed since as long before. Unknown before the second pose, and where no
    robot drives so fast.
    """
    last = min(int(np.searchsorted(track.t_ns, t_ns, side="left")), len(track) - 1)
    if last < 1:
        return UNKNOWN_TWIST
    known_ns, first_ns = int(track.t_ns[last]), int(track.t_ns[0])
    end_ns = min(t_ns + round(span_s[1] * 1e9), known_ns)
    length_ns = max(round((span_s[1] - span_s[0]) * 1e9), 1_000_000)
    begin_ns = max(end_ns - length_ns, first_ns)
    if begin_ns >= end_ns:
        return UNKNOWN_TWIST
    motion = between(track.at(begin_ns), track.at(end_ns))
    duration_s = (end_ns - begin_ns) / 1e9
    right, backward = arc_log(motion) / duration_s
    turn = float(motion[2]) / duration_s
    if np.hypot(right, backward) > MOST_SPEED_M_S or abs(turn) > MOST_TURN_RAD_S:
        return UNKNOWN_TWIST
    step_ns = max(length_ns, known_ns - int(track.t_ns[last - 1]))
    before_ns, changed = max(begin_ns - step_ns, first_ns), 0.0
    if before_ns < begin_ns:
        turned = float(between(track.at(before_ns), track.at(begin_ns))[2])
        changed = turn - turned * 1e9 / (begin_ns - before_ns)
    return Twist(float(right), float(backward), turn, float(np.hypot(WHEELS_SHARE * turn, changed / 2)))
