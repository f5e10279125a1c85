"""The probability that an estimate is right, and the reason why it is low.

An estimate is right within 0.5 m and 10°. This is the case when the truth is among the particles, and when the
particles near the estimate are the right ones: p_correct = (1 - P(lost)) · weight of the particles near the estimate.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, wrap_angle
from localiser.particles import Particles

CORRECT_M, CORRECT_RAD = 0.5, np.radians(10.0)
SURE = 0.9  # from here on nothing needs a reason

Reason = Literal["", "no edges", "edges contradict the map", "several places fit"]


def confidence_of(particles: Particles, pose: Array, p_lost: float, is_empty: bool) -> tuple[float, Reason]:
    """Return the probability that the estimate `pose` (3,) is correct, and why it is low, "" where it is not.

    p_lost: probability that the truth is not among the particles. is_empty: whether the image showed nothing.
    """
    near = near_weight(particles, pose)
    p_correct = (1.0 - p_lost) * near
    if p_correct >= SURE:
        return p_correct, ""
    if is_empty:
        return p_correct, "no edges"
    return p_correct, "edges contradict the map" if p_lost > 1.0 - near else "several places fit"


def near_weight(particles: Particles, pose: Array) -> float:
    """Return the weight, 0 … 1, of the particles within 0.5 m and 10° of `pose` (3,)."""
    return float(min(particles.weight[is_near(particles.poses, pose)].sum(), 1.0))


def is_near(poses: Array, pose: Array) -> NDArray[np.bool_]:
    """Return which of the poses (N, 3) are within 0.5 m and 10° of `pose` (3,)."""
    near = np.hypot(poses[:, 0] - pose[0], poses[:, 1] - pose[1]) < CORRECT_M
    return np.asarray(near & (np.abs(wrap_angle(poses[:, 2] - pose[2])) < CORRECT_RAD))
