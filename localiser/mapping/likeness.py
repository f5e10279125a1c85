"""How much two edges look alike: polarity, and the grey values left and right of each.

The grey value beside an edge is that of a surface and stays; but at an outer corner one side is whatever lies behind,
which changes with the viewpoint. So each side is alike with some probability, else it is anything.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array

_SAME_SIDE = 0.7  # share of sides that show the same surface again
_GREY_SIGMA = 12.0  # how much that differs: light that falls otherwise, blur, noise
_GREY_SPAN = 128.0  # over which the grey values of other edges spread


def log_likeness(side: Array, polarity: NDArray[np.int8], other_side: Array, other_polarity: NDArray[np.int8]) -> Array:
    """Return the log-likelihood ratio (A, B) of edges (A) and (B) being one edge, by looks alone.

    side: (A, 2), other_side: (B, 2) grey values left and right, nan unknown. polarity: (A,) and (B,), 0 unknown.
    -inf where polarities contradict each other.
    """
    return log_likeness_of_pairs(side[:, None], polarity[:, None], other_side[None], other_polarity[None])


def log_likeness_of_pairs(
    side: Array, polarity: NDArray[np.int8], other_side: Array, other_polarity: NDArray[np.int8]
) -> Array:
    """Return the same of pairs (P): side, other_side: (P, 2). polarity, other_polarity: (P,)."""
    apart = side - other_side
    same = _SAME_SIDE * np.exp(-0.5 * (apart / _GREY_SIGMA) ** 2) / (_GREY_SIGMA * np.sqrt(2 * np.pi))
    ratio = np.log(same * _GREY_SPAN + 1 - _SAME_SIDE)
    looks = np.where(np.isnan(ratio), 0.0, ratio).sum(axis=-1)
    product = polarity * other_polarity
    return np.asarray(np.where(product < 0, -np.inf, looks + np.log(2.0) * (product > 0)))
