"""Resampling: draw particles so that each has on average as many offspring as its weight says.

Each scheme takes weights (N,), a number of offspring and a generator, and returns ascending indices (count,) with
E[offspring of i] = count · w_i / Σ w. The systematic scheme has the smallest variance about that mean; the multinomial
one draws each index independently. `enough_particles` says how many particles are needed.

Weights need not sum to 1, so a cumulative sum that is below 1 by rounding is no problem. Zero weights get no offspring.
"""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.particles.clusters import occupied_cells

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


def enough_particles(poses: Array, cell_m: float, cell_rad: float, error: float = 0.05, risk: float = 0.01) -> int:
    """Return how many particles a cloud as wide as poses (N, 3) needs, by KLD-sampling [Fox 2003, eq. 7].

    With that many, the Kullback-Leibler distance between the particles' histogram and the true one stays below `error`
    with probability 1 - `risk`. The histogram has cells of cell_m × cell_m × cell_rad (x, z, heading), of which only
    the occupied ones count: χ² of their number less 1 at 1 - `risk`, over 2 · `error`. Raises ValueError when a cell is
    not larger than zero.
    """
    freedom = occupied_cells(poses, cell_m, cell_rad) - 1
    if freedom < 1:
        return 1
    spread = 2.0 / (9.0 * freedom)  # Wilson and Hilferty's quantile
    quantile = freedom * (1.0 - spread + np.sqrt(spread) * NormalDist().inv_cdf(1.0 - risk)) ** 3
    return int(np.ceil(quantile / (2.0 * error)))


def _cumulative(weight: Array) -> tuple[Array, int]:
    """Return the cumulative sum (N,) and the index of the last particle that has any weight; checks the weights."""
    cumulative = np.cumsum(weight, dtype=np.float64)
    total = cumulative[-1] if len(cumulative) else 0.0
    if not np.isfinite(total) or total <= 0:
        raise ValueError(f"weights sum to {total}")
    if np.min(weight) < 0:
        raise ValueError(f"weight {np.min(weight)} is negative")
    return cumulative, int(np.flatnonzero(weight)[-1])
