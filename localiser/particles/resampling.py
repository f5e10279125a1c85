"""Resampling: draw particles so that each has on average as many offspring as its weight says.

Each scheme takes weights (N,), a number of offspring and a generator, and returns ascending indices (count,) with
E[offspring of i] = count · w_i / Σ w. The systematic scheme has the smallest variance about that mean; the multinomial
one draws each index independently.

Weights need not sum to 1, so a cumulative sum that is below 1 by rounding is no problem. Zero weights get no offspring.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array

Indices = NDArray[np.int64]


def systematic_resample(weight: Array, count: int, rng: np.random.Generator) -> Indices:
    """Return `count` indices from an even comb with one uniform offset: offspring are ⌊count·w⌋ or ⌈count·w⌉.

    weight: (N,) not negative, of any positive sum. Raises ValueError when the sum is zero or not finite, or a weight is
    negative. [Carpenter, Clifford, Fearnhead 1999]
    """
    offset = rng.random()
    cumulative, last = _cumulative(weight)
    place = cumulative * (count / cumulative[-1])
    whole = np.minimum(place.astype(np.int64), count - 1)
    # Teeth of the comb below `place`: all at whole numbers before, and the next one if it comes first.
    below = whole + (offset < place - whole)
    below[last:] = count
    return np.repeat(np.arange(len(below)), np.diff(below, prepend=0))


def multinomial_resample(weight: Array, count: int, rng: np.random.Generator) -> Indices:
    """Return `count` indices drawn independently, in ascending order [Gordon, Salmond, Smith 1993].

    weight: as for `systematic_resample`, with the same errors.
    """
    cumulative, last = _cumulative(weight)
    drawn = np.sort(rng.random(count)) * cumulative[-1]
    return np.asarray(np.minimum(np.searchsorted(cumulative, drawn, side="right"), last))


def _cumulative(weight: Array) -> tuple[Array, int]:
    """Return the cumulative sum (N,) and the index of the last particle that has any weight; checks the weights."""
    cumulative = np.cumsum(weight, dtype=np.float64)
    total = cumulative[-1] if len(cumulative) else 0.0
    if not np.isfinite(total) or total <= 0:
        raise ValueError(f"weights sum to {total}")
    if np.min(weight) < 0:
        raise ValueError(f"weight {np.min(weight)} is negative")
    return cumulative, int(np.flatnonzero(weight)[-1])
