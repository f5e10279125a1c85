"""Consistency of a filter: normalised estimation error squared (NEES) and its χ² bands.

[Bar-Shalom, Li, Kirubarajan 2001, section 5.4.2]
"""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array


def nees(error: Array, cov: Array) -> Array:
    """Return eᵀ P⁻¹ e (T,) of errors (T, D), angles wrapped, under covariances (T, D, D).

    About D when the filter is consistent, more when it is overconfident. nan where the error is not known or the
    covariance is not positive definite: a start that is known exactly, or particles that have become one.
    """
    result = np.full(len(error), np.nan)
    known = np.isfinite(error).all(axis=-1) & np.isfinite(cov).all(axis=(-2, -1))
    variance, axes = np.linalg.eigh(cov[known])
    # Positive definite beyond rounding: a collapsed direction would make the figure a matter of the last bit.
    sound = variance[:, 0] > 1e-12 * variance[:, -1]
    across = np.einsum("tij,ti->tj", axes[sound], error[known][sound])
    result[np.flatnonzero(known)[sound]] = (across**2 / variance[sound]).sum(axis=-1)
    return result


def nees_band(runs: int = 1, dimensions: int = 3, probability: float = 0.95) -> tuple[float, float]:
    """Return the band that the mean NEES of `runs` independent runs lies in with this probability: χ²(D·S) / S."""
    from scipy.special import gammaincinv

    half_dof = dimensions * runs / 2
    tails = np.array([(1 - probability) / 2, (1 + probability) / 2])
    low, high = 2 * gammaincinv(half_dof, tails) / runs
    return float(low), float(high)


def fraction_inside(nees_of_runs: Array, dimensions: int = 3, probability: float = 0.95) -> float:
    """Return the fraction of frames in which the NEES, averaged over S runs (S, T), is inside its χ² band.

    Frames that any run has no NEES for are left out; nan when none is left.
    """
    mean = np.atleast_2d(nees_of_runs).mean(axis=0)
    mean = mean[np.isfinite(mean)]
    low, high = nees_band(len(np.atleast_2d(nees_of_runs)), dimensions, probability)
    return float(((mean >= low) & (mean <= high)).mean()) if len(mean) else float("nan")
