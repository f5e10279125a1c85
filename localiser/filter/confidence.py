"""Am I lost? The probability that the estimate is right, where else the robot may be, and why it is not sure.

An estimate is correct within 0.5 m and 10°. It is, when the truth is among the particles and those near the estimate
are the right ones: p_correct = (1 - P(lost)) · weight of the particles near the estimate. P(lost) is that of `doubt`,
or of a `rival`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, wrap_angle
from localiser.particles import Clusters, Particles, find_clusters

CORRECT_M, CORRECT_RAD = 0.5, np.radians(10.0)
SURE = 0.9  # from here on nothing needs a reason

Reason = Literal["", "no edges", "edges contradict the map", "several places fit"]


@dataclass(frozen=True, slots=True, eq=False)
class Confidence:
    """p_correct: probability, 0 … 1, that the estimate is within 0.5 m and 10°. reason: why it is low, "" where not.

    clusters: the places where the robot may be, heaviest first.
    """

    p_correct: float
    reason: Reason
    clusters: Clusters


def confidence_of(particles: Particles, pose: Array, lost: float, edges: int, clusters: Clusters) -> Confidence:
    """Return how sure the filter may be of the estimate `pose` (3,).

    lost: probability that the truth is not among the particles. edges: how many the image showed.
    """
    near = near_weight(particles, pose)
    p_correct = (1.0 - lost) * near
    return Confidence(p_correct, _reason(p_correct, near, lost, edges), clusters)


def near_weight(particles: Particles, pose: Array) -> float:
    """Return the share of the particles' weight within 0.5 m and 10° of `pose` (3,)."""
    return float(min(particles.weight[beside(particles.poses, pose)].sum(), 1.0))


def beside(poses: Array, pose: Array) -> NDArray[np.bool_]:
    """Return which of the poses (N, 3) are within 0.5 m and 10° of `pose` (3,)."""
    near = np.hypot(poses[:, 0] - pose[0], poses[:, 1] - pose[1]) < CORRECT_M
    return np.asarray(near & (np.abs(wrap_angle(poses[:, 2] - pose[2])) < CORRECT_RAD))


def _reason(p_correct: float, near: float, lost: float, edges: int) -> Reason:
    if p_correct >= SURE:
        return ""
    if edges == 0:
        return "no edges"
    if lost > 1.0 - near:
        return "edges contradict the map"
    return "several places fit"


def places_of(particles: Particles) -> Clusters:
    """Return the clusters of the particles."""
    return find_clusters(particles.poses, particles.weight)
