"""95 % intervals of shares, of runs and of frames of runs, and of rates of rare events."""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array

NORMAL_95 = 1.959964
Interval = tuple[float, float, float]


def wilson(passed: int, count: int) -> Interval:
    """Return the share of `passed` in `count` and its 95 % interval [Wilson 1927], right also at 0 and 1."""
    share, z2 = passed / count, NORMAL_95**2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = NORMAL_95 / (1 + z2 / count) * np.sqrt(share * (1 - share) / count + z2 / (4 * count**2))
    return share, max(middle - half, 0.0), min(middle + half, 1.0)


def share_of_frames(hits: Array, frames: Array, resamples: int = 2000) -> Interval:
    """Return Σ hits / Σ frames of seeds (S,) and its 95 % interval; frames of one seed are not independent."""
    drawn = np.random.default_rng(0).integers(len(hits), size=(resamples, len(hits)))
    shares = hits[drawn].sum(axis=1) / frames[drawn].sum(axis=1)
    return (float(hits.sum() / frames.sum()), *(float(q) for q in np.quantile(shares, [0.025, 0.975])))


def rate_bound(count: int, exposure: float) -> float:
    """Return the one-sided 95 % bound of the rate of a Poisson process with `count` events in `exposure`."""
    from scipy.special import gammaincinv

    return float(gammaincinv(count + 1, 0.95)) / exposure
