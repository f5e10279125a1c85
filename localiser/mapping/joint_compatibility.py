"""Joint compatibility: which pairs of landmarks may be one, all at the same time.

Drift moves everything that was seen at one time together, so pairs that are one agree on how far it has moved. Each
pair that is taken to be one is a measurement that its two landmarks stand at one place. By the joint covariance of all
differences it changes what the differences of the other pairs should be, as in a Kalman filter. The largest set of
pairs in which each agrees with the others is the hypothesis [Neira, Tardós 2001]. Where another set explains nearly as
many pairs, as among things that repeat at equal distances, neither is chosen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array

Mask = NDArray[np.bool_]

_GATE = 11.8  # 99.7 % of a Gaussian in the plane
_CLEARLY = 1.4  # so many times as many pairs must speak for one set as for another one


def compatible(difference: Array, cov: Array, noise_m: float) -> Mask:
    """Return which pairs (P,) are one: the largest set that agrees, without what another set explains nearly as well.

    difference: (P, 2) m. cov: (2 P, 2 P) m² of all differences. noise_m: sigma by which two sightings of one thing
    differ.
    """
    sets: list[Mask] = []
    for seed in range(len(difference)):
        # A pair of a set that was found grows the same set or one that is nearly the same.
        if not any(found[seed] for found in sets):
            sets.append(_grown(seed, difference, cov, noise_m))
    kept = best = max(sets, key=lambda found: int(found.sum()), default=np.zeros(0, dtype=bool))
    for other in sets:
        contrary = best & ~other
        if _CLEARLY * (other & ~best).sum() > contrary.sum():
            kept = kept & ~contrary
    return kept


def _grown(seed: int, difference: Array, cov: Array, noise_m: float) -> Mask:
    """Return the pairs (P,) that agree with the pair `seed` and with each other; those that agree best come first."""
    count = len(difference)
    chosen, fits = np.zeros(count, dtype=bool), np.ones(count, dtype=bool)
    mean, left, noise = difference.ravel(), cov, noise_m**2 * np.eye(2)
    pair = seed
    while True:
        own = slice(2 * pair, 2 * pair + 2)
        gain = np.linalg.solve(left[own, own] + noise, left[own]).T
        mean, left = mean - gain @ mean[own], left - gain @ left[own]
        chosen[pair] = True
        offset, blocks = mean.reshape(count, 2), left.reshape(count, 2, count, 2)
        own_cov = blocks[np.arange(count), :, np.arange(count)] + noise
        chi2 = np.einsum("pi,pij,pj->p", offset, np.linalg.inv(own_cov), offset)
        fits &= (chi2 < _GATE) & ~chosen
        if not fits.any():
            return chosen
        pair = int(np.where(fits, chi2, np.inf).argmin())
