"""When an estimate is correct, how probable that is, and why it is improbable."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, wrap_angle
from localiser.particles import Particles

CORRECT_M, CORRECT_RAD = 0.5, np.radians(10.0)
SURE = 0.9  # from here on nothing needs a reason
LEAST_SURE = 0.5  # below this a pose is more likely wrong than right

Reason = Literal["", "no edges", "edges contradict the map", "several places fit", "not found yet"]
NOT_FOUND: Reason = "not found yet"
MapWarning = Literal["", "this map does not fit"]


def near_weight(particles: Particles, pose: Array) -> float:
    """Return the weight, 0 … 1, of the particles within 0.5 m and 10° of `pose` (3,)."""
    return float(min(particles.weight[is_near(particles.poses, pose)].sum(), 1.0))


def is_near(poses: Array, pose: Array) -> NDArray[np.bool_]:
    """Return which of the poses (N, 3) are within 0.5 m and 10° of `pose` (3,)."""
    near = np.hypot(poses[:, 0] - pose[0], poses[:, 1] - pose[1]) < CORRECT_M
    return np.asarray(near & (np.abs(wrap_angle(poses[:, 2] - pose[2])) < CORRECT_RAD))
