"""Events: the measurements that the filter takes, in the order of time, and its result for each image."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from localiser.edges import Edges
from localiser.filter.attitude import Attitude
from localiser.filter.confidence import MapWarning, Reason
from localiser.filter.height import Height
from localiser.filter.map_error import MapError
from localiser.geometry import Array, Increment, Trajectory
from localiser.observation import Matches, Sighting
from localiser.particles import Clusters, Estimate, Particles


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
    them shows, seen from the estimate. warning: what a user should look
    at, else "".
    wheels_are_wrong: whether edges and map contradict the wheels, so that the robot is followed without them.
    odometry_jumped: whether odometry began anew since the last image, so that the motion was bridged.
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
