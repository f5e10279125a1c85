"""Events: the measurements that the filter takes, in the order of time, and its result for each image."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from localiser.edges import Edges
from localiser.filter.attitude import Attitude
from localiser.filter.height import Height
from localiser.filter.map_error import MapError
from localiser.geometry import Array, Increment, Trajectory, between, bridged, wrap_angle
from localiser.observation import Matches, Sighting
from localiser.particles import Clusters, Estimate, Particles

MOVE_M, MOVE_RAD = 0.5, 0.3  # the longest way and turn that are taken as one step
SILENT_NS = 1_000_000_000  # between two poses of odometry, from which on they do not tell how the robot moved between
CORRECT_M, CORRECT_RAD = 0.5, np.radians(10.0)
SURE = 0.9  # from here on nothing needs a reason
LEAST_SURE = 0.5  # below this a pose is more likely wrong than right

Reason = Literal["", "no edges", "edges contradict the map", "several places fit", "not found yet"]
NOT_FOUND: Reason = "not found yet"
MapWarning = Literal["", "this map does not fit"]


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where the robot is said to be: pose (3,) in the map and its covariance (3, 3)."""

    t_ns: int
    mean: Array
    cov: Array


@dataclass(frozen=True, slots=True, eq=False)
class Anywhere:
    """Nothing is known of where the robot is from this time on."""

    t_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """A pose (3,) in the odometry's own frame; only increments between two of them count."""

    t_ns: int
    pose: Array


def track_of(odometry: Iterable[Odometry]) -> Trajectory:
    """Return poses of odometry as one trajectory; there may be none."""
    poses = list(odometry)
    times_ns = np.array([pose.t_ns for pose in poses], dtype=np.int64)
    return Trajectory(times_ns, np.array([pose.pose for pose in poses]).reshape(-1, 3))


Event = Start | Anywhere | Odometry | Sighting


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
    jumped = any(times[jump] > start_ns and times[jump - 1] < t_ns for jump in jumps)
    knots_ns = np.array([start_ns, *times[(times > start_ns) & (times < t_ns)], t_ns])
    late_ns = knots_ns - round(1e9 * delay_s)
    knots = track.sampled(np.append(knots_ns, late_ns)).poses.reshape(2, -1, 3)
    steps = between(knots[0, :-1], knots[0, 1:])
    path_m, turned_rad = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    move = np.floor(np.cumsum(path_m / MOVE_M + turned_rad / MOVE_RAD))
    ends = np.array([0, *np.flatnonzero(np.diff(move)) + 1, len(steps)])
    means, late = between(knots[:, ends[:-1]], knots[:, ends[1:]])
    # A secant over a typical delay, since velocities that are commanded jump.
    by_delay = late - means
    by_delay[:, 2] = wrap_angle(by_delay[:, 2])
    by_delay /= delay_s or 1.0
    paths, turns = np.add.reduceat([path_m, turned_rad], ends[:-1], axis=1)
    parts = zip(means, paths, turns, by_delay, strict=True)
    moves = [Increment(mean, np.zeros((3, 3)), path, turned, per_s) for mean, path, turned, per_s in parts]
    pose = raw.at(t_ns) if len(jumps) else knots[0, -1]
    # Keep the last pose at or before where the next increment, or a later robot's, starts, and the one before it.
    while len(odometry) > 2 and odometry[2].t_ns <= t_ns - round(1e9 * delay_s):
        odometry.popleft()
    return moves, pose, jumped


def is_silent(odometry: deque[Odometry], start_ns: int, t_ns: int) -> bool:
    """Return whether odometry was silent at some time between `start_ns` and `t_ns`, so that poses say little of it."""
    times = np.array([pose.t_ns for pose in odometry])
    before, after = times[:-1], times[1:]
    return bool(((after - before > SILENT_NS) & (before < t_ns) & (after > start_ns)).any())


def is_near(poses: Array, pose: Array) -> NDArray[np.bool_]:
    """Return which of the poses (N, 3) are within 0.5 m and 10° of `pose` (3,)."""
    near = np.hypot(poses[:, 0] - pose[0], poses[:, 1] - pose[1]) < CORRECT_M
    return np.asarray(near & (np.abs(wrap_angle(poses[:, 2] - pose[2])) < CORRECT_RAD))


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """What the filter knows after one image.

    estimate: from the weighted particles, before resampling; where several places are possible, from those at the
    likeliest one. particles: all of them. ess: effective sample size. edges: as they were measured. increment: motion
    since the last image. odometry: odometry's pose (3,) at the image. p_correct: probability that the estimate is
    within 0.5 m and 10°. reason: why it is below 0.9, else "". clusters: the places where the robot may be, heaviest
    first. attitude: by how much tilt and roll differ from what is stated, None where edges do not tell. height: by how
    much the camera's height above the floor does. map_error: how far landmarks are from where the map has them.
    sighting: what particles were weighed by, edges corrected by attitude and height. matches: which landmark each of
    them shows, seen from the estimate. warning: what a user should look at, else "". wheels_are_wrong: whether edges
    and map contradict the wheels, so that the robot is followed without them. odometry_jumped: whether odometry began
    anew since the last image, so that the motion was bridged. took_over: whether the pose jumped to another place than
    was tracked until this image.
    """

    t_ns: int
    estimate: Estimate
    particles: Particles
    ess: float
    edges: Edges
    increment: Increment
    odometry: Array
    p_correct: float = 1.0
    reason: Reason = ""
    clusters: Clusters | None = None
    attitude: Attitude | None = None
    height: Height = field(default_factory=Height)
    map_error: MapError = field(default_factory=MapError)
    sighting: Sighting | None = None
    matches: Matches = field(default_factory=lambda: Matches.none(0, 0))
    warning: MapWarning = ""
    wheels_are_wrong: bool = False
    odometry_jumped: bool = False
    took_over: bool = False
