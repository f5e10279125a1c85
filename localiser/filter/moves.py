"""The motion between two images, interpolated from odometry."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.filter.events import Odometry, track_of
from localiser.geometry import Array, Increment, Trajectory, bridged

MOVE_M, MOVE_RAD = 0.5, 0.3  # the longest way and turn that are taken as one step
SILENT_NS = 1_000_000_000  # between two poses of odometry, from which on they do not tell how the robot moved between


def moves_between(
    odometry: deque[Odometry], start_ns: int, t_ns: int, delay_s: float = 0.0
) -> tuple[list[Increment], Array, bool]:
    """Return the motion from `start_ns` until `t_ns`, the odometry's pose (3,) then, and whether it jumped between.

    What is past is forgotten. A jump is bridged, see `geometry.bridged`.

    Poses are interpolated at both ends, so the increments are exact whatever the rates of the two sensors. A long way
    is cut into moves short enough for the motion model, which is linear in what it does not know. delay_s: by how much
    the robot may be later than its odometry.
    """
    if not odometry:
        return [Increment.from_mean(np.zeros(3))], np.zeros(3), False
    raw = track_of(odometry)
    track, jumps = bridged(raw)
    times = track.t_ns
    jumped = bool(((times[jumps] > start_ns) & (times[jumps - 1] < t_ns)).any())
    inside = times[(times > start_ns) & (times < t_ns)]
    knots_ns = np.array([start_ns, *inside, t_ns])
    knots = track.sampled(knots_ns).poses
    steps = geometry.between(knots[:-1], knots[1:])
    path_m, turned_rad = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    move = np.floor(np.cumsum(path_m / MOVE_M + turned_rad / MOVE_RAD)).astype(np.int64)
    first = np.flatnonzero(np.diff(move, prepend=-1))
    ends = np.append(first, len(steps))
    means = geometry.between(knots[ends[:-1]], knots[ends[1:]])
    by_delay = _by_delay(track, knots_ns[ends], means, delay_s)
    paths, turns = np.add.reduceat(path_m, first), np.add.reduceat(turned_rad, first)
    moves = [
        Increment(mean, np.zeros((3, 3)), path, turned, late)
        for mean, path, turned, late in zip(means, paths, turns, by_delay, strict=True)
    ]
    pose = raw.at(t_ns)
    # Keep the last pose at or before where the next increment, or a later robot's, starts, and the one before it.
    while len(odometry) > 2 and odometry[2].t_ns <= t_ns - round(1e9 * delay_s):
        odometry.popleft()
    return moves, pose, jumped


def _by_delay(track: Trajectory, ends_ns: NDArray[np.int64], means: Array, delay_s: float) -> Array:
    """Return how motions (M, 3) between times (M + 1,) change per second by which the robot is later than its odometry.

    A secant over a typical delay, since velocities that are commanded jump.
    """
    if delay_s == 0:
        return np.zeros_like(means)
    late = track.sampled(ends_ns - round(1e9 * delay_s)).poses
    change = geometry.between(late[:-1], late[1:]) - means
    change[:, 2] = geometry.wrap_angle(change[:, 2])
    return np.asarray(change / delay_s)


def is_silent(odometry: deque[Odometry], start_ns: int, t_ns: int) -> bool:
    """Return whether odometry was silent at some time between `start_ns` and `t_ns`, so that poses say little of it."""
    times = np.array([pose.t_ns for pose in odometry])
    before, after = times[:-1], times[1:]
    return bool(((after - before > SILENT_NS) & (before < t_ns) & (after > start_ns)).any())
