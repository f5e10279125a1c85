"""Resampling: which particles live on, so that each has on average as many offspring as its weight says.

Every scheme here takes weights (N,), a number of offspring and a generator, and returns ascending indices (count,)
with E[offspring of i] = count · w_i / Σ w. They differ in the scatter about that mean, from small to large: systematic,
stratified, residual, multinomial [Douc, Cappé, Moulines 2005]. `enough_particles` says how many are needed.

Weights need not sum to 1, so a cumulative sum that rounding leaves below 1 does no harm; zeros get no offspring.
"""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array

Indices = NDArray[np.int64]


def systematic_resample(weight: Array, count: int, rng: np.random.Generator) -> Indices:
    """Return `count` indices from an even comb with one uniform offset: offspring are ⌊count·w⌋ or ⌈count·w⌉.

    weight: (N,) not negative, of any positive sum. Raises ValueError when the sum is zero or not finite, or a weight is
    negative. [Carpenter, Clifford, Fearnhead 1999]
    """
    return _comb(weight, count, np.broadcast_to(rng.random(), count))


def stratified_resample(weight: Array, count: int, rng: np.random.Generator) -> Indices:
    """Return `count` indices from one uniform draw in each of `count` equal strata [Kitagawa 1996].

    weight: as for `systematic_resample`, with the same errors.
    """
    return _comb(weight, count, rng.random(count))


def multinomial_resample(weight: Array, count: int, rng: np.random.Generator) -> Indices:
    """Return `count` indices drawn independently, in ascending order [Gordon, Salmond, Smith 1993].

    weight: as for `systematic_resample`, with the same errors.
    """
    cumulative, last = _cumulative(weight)
    drawn = np.sort(rng.random(count)) * cumulative[-1]
    return np.asarray(np.minimum(np.searchsorted(cumulative, drawn, side="right"), last))


def residual_resample(weight: Array, count: int, rng: np.random.Generator) -> Indices:
    """Return `count` indices: ⌊count·w⌋ of each for certain, the rest drawn by what is left over [Liu, Chen 1998].

    weight: as for `systematic_resample`, with the same errors.
    """
    cumulative, _ = _cumulative(weight)
    expected = np.asarray(weight) * (count / cumulative[-1])
    certain = np.floor(expected).astype(np.int64)
    # Rounding can lift whole numbers above their sum (six weights of 1/6 may each expect a hair more than 1).
    index = np.repeat(np.arange(len(certain)), certain)[:count]
    missing = count - len(index)
    if missing == 0:
        return index
    drawn = multinomial_resample(expected - certain, missing, rng)
    return np.sort(np.concatenate([index, drawn]))


def enough_particles(poses: Array, cell_m: float, cell_rad: float, error: float = 0.05, doubt: float = 0.01) -> int:
    """Return how many particles a cloud as wide as poses (N, 3) needs, by KLD-sampling [Fox 2003, eq. 7].

    With that many, the Kullback-Leibler distance between the particles' histogram and the true one stays below `error`
    with probability 1 - `doubt`. The histogram has cells of cell_m × cell_m × cell_rad (x, z, heading), of which only
    the occupied ones count. Raises ValueError when a cell is not larger than zero.
    """
    return particles_for_cells(occupied_cells(poses, cell_m, cell_rad), error, doubt)


def particles_for_cells(cells: int, error: float = 0.05, doubt: float = 0.01) -> int:
    """Return the number of particles for k occupied `cells`: χ²(k-1) at 1 - `doubt`, over 2 · `error` [Fox 2003].

    The quantile is Wilson and Hilferty's. One cell needs one particle.
    """
    if cells <= 1:
        return 1
    freedom = cells - 1
    spread = 2.0 / (9.0 * freedom)
    quantile = freedom * (1.0 - spread + np.sqrt(spread) * NormalDist().inv_cdf(1.0 - doubt)) ** 3
    return int(np.ceil(quantile / (2.0 * error)))


def occupied_cells(poses: Array, cell_m: float, cell_rad: float) -> int:
    """Return in how many cells of cell_m × cell_m × cell_rad poses (N, 3) lie; the heading's cells close the circle."""
    if not (cell_m > 0 and cell_rad > 0):
        raise ValueError(f"cells of {cell_m} m and {cell_rad} rad")
    around = max(round(2 * np.pi / cell_rad), 1)  # whole cells, so that none is cut at ±π
    column, row = np.floor(poses[:, :2].T / cell_m).astype(np.int64)
    sector = np.floor(poses[:, 2] * (around / (2 * np.pi))).astype(np.int64) % around
    column, row = column - column.min(initial=0), row - row.min(initial=0)
    return len(np.unique((column * (row.max(initial=0) + 1) + row) * around + sector))


def _comb(weight: Array, count: int, offset: Array) -> Indices:
    """Return the indices that the comb's teeth k + offset_k (count,), each in [0, 1), fall on."""
    cumulative, last = _cumulative(weight)
    place = cumulative * (count / cumulative[-1])
    whole = np.minimum(place.astype(np.int64), count - 1)
    # Teeth below `place`: all of the strata before, and that of its own stratum if it comes first.
    below = whole + (offset[whole] < place - whole)
    below[last:] = count
    return np.repeat(np.arange(len(below)), np.diff(below, prepend=0))


def _cumulative(weight: Array) -> tuple[Array, int]:
    """Return the cumulative sum (N,) and the index of the last particle that has any weight; checks the weights."""
    cumulative = np.cumsum(weight, dtype=np.float64)
    total = cumulative[-1] if len(cumulative) else 0.0
    if not np.isfinite(total) or total <= 0:
        raise ValueError(f"weights sum to {total}")
    if np.min(weight) < 0:
        raise ValueError(f"weight {np.min(weight)} is negative")
    return cumulative, int(np.flatnonzero(weight)[-1])
