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
    """Return the pairs (P,) that agree with the pair `seed` and with each other; those that agree best come first.

    Each pair taken is a measurement of its own difference. What it tells of all others is a factor (2 P, 2): the
    covariance that is left is `cov` less the sum of factor · factorᵀ. Of it, only what is asked for is computed.
    """
    count = len(difference)
    chosen, fits = np.zeros(count, dtype=bool), np.ones(count, dtype=bool)
    mean, told, noise = difference.ravel().copy(), np.zeros((2 * count, 2 * count)), noise_m**2 * np.eye(2)
    own_cov = cov.reshape(count, 2, count, 2)[np.arange(count), :, np.arange(count)] + noise
    pair = seed
    for taken in range(0, 2 * count, 2):
        own = slice(2 * pair, 2 * pair + 2)
        with_all = cov[:, own] - told[:, :taken] @ told[own, :taken].T
        whitening = np.linalg.inv(np.linalg.cholesky(with_all[own] + noise)).T
        factor = with_all @ whitening
        mean -= factor @ (whitening.T @ mean[own])
        told[:, taken : taken + 2] = factor
        of_pair = factor.reshape(count, 2, 2)
        own_cov -= of_pair @ of_pair.transpose(0, 2, 1)
        chosen[pair] = True
        chi2 = _chi2(mean.reshape(count, 2), own_cov)
        fits &= (chi2 < _GATE) & ~chosen
        if not fits.any():
            break
        pair = int(np.where(fits, chi2, np.inf).argmin())
    return chosen


def _chi2(offset: Array, cov: Array) -> Array:
    """Return the squared sigmas (P,) of offsets (P, 2) with covariances (P, 2, 2)."""
    (x, z), (xx, xz, zz) = offset.T, (cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1])
    return np.asarray((zz * x**2 - 2 * xz * x * z + xx * z**2) / (xx * zz - xz**2))
