"""Pairs of edges of two images that may be one edge, and how likely each is under a motion.

An edge of the second image continues one of the n edges of the first with probability w, each equally likely; otherwise
it is new. Polarities must agree. Grey values agree on at least one side, because the background on the other side
changes. Given a motion, the bearing is predicted for two cases of the edge's lower end:

- it is the foot, where the edge meets the floor, and determines the range, or
- it is not (a window, a skirting board, something in front), and the edge is at any shorter range.

The bearing itself may also be that of a neighbouring edge, a few pixels away, when each image shows only one of the
two. Such a pair is not a new edge, but it gives no information.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.edges import Edges
from localiser.geometry import Array

FOLLOWED_SHARE = 0.7  # of the edges of an image, seen in the one before
FLOOR_SHARE = 0.5  # of the lower ends that are feet
HUNG_SHARE = 0.5  # of the others, that hang at a height of their own; the rest is hidden by something in front
TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD = 0.4, 0.3  # 1/m: rooms are some metres wide, and edges stand all over them
NEIGHBOUR_SHARE = 0.15  # of pairs whose bearings are of two edges beside each other
NEIGHBOUR_SIGMA_RAD = np.deg2rad(0.3)  # how far apart
LOOK_SIGMA = 12.0  # grey levels that an unchanged side of an edge differs by
LOOK_FLOOR = 0.1  # likelihood of an edge whose both sides changed, beside one that did not


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """P pairs that may be one edge: first, second (P,) indices of edges. look: (P,) how alike, 0 … 1."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    look: Array


def candidates(before: Edges, after: Edges) -> Pairs:
    """Return all pairs of edges with polarities that do not contradict each other."""
    product = before.polarity[:, None].astype(int) * after.polarity
    first, second = np.nonzero(product >= 0)
    return Pairs(first, second, _look(before.profile, after.profile)[first, second])


def _look(before: Array, after: Array) -> Array:
    """Return how alike (E, F) profiles (E, P) and (F, P) are: the side that changed less decides; 1 where unknown."""
    if before.shape[1] == 0 or before.shape[1] != after.shape[1]:
        return np.ones((len(before), len(after)))
    square = (before[:, None] - after) ** 2
    half = square.shape[-1] // 2
    nearer = np.minimum(square[..., :half].mean(axis=-1), square[..., -half:].mean(axis=-1))
    return np.asarray(np.maximum(np.nan_to_num(np.exp(-0.5 * nearer / LOOK_SIGMA**2), nan=1.0), LOOK_FLOOR))


def _floor_shares() -> tuple[Array, Array]:
    """Return a table of inverse ranges ρ (1/m), and how likely a lower end that would be a foot there is one.

    With p(ρ) what is typical, a foot is there with p(ρ), and an end at any height up to the camera's, which looks
    farther than it is, with ∫ p(r)/r dr from ρ on: near the horizon hardly anything stands on the floor.
    """
    inverse = np.geomspace(1e-3, TYPICAL_INVERSE_RANGE + 6.0 * TYPICAL_SPREAD, 200)
    feet = np.exp(-0.5 * ((inverse - TYPICAL_INVERSE_RANGE) / TYPICAL_SPREAD) ** 2)
    steps = 0.5 * (feet[1:] + feet[:-1]) * np.diff(np.log(inverse))  # dr/r = d log r
    hanging = np.append(np.cumsum(steps[::-1])[::-1], 0.0)
    return inverse, FLOOR_SHARE * feet / (FLOOR_SHARE * feet + (1.0 - FLOOR_SHARE) * hanging)


FLOOR_SHARES = _floor_shares()
