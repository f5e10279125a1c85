"""Efficiency of a filter over many seeds: its error divided by the limit of accuracy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.geometry import Array


@dataclass(frozen=True, slots=True)
class Efficiency:
    """RMSE over bound: 1 is the limit, more is worse. low, high: bootstrap confidence interval over the seeds."""

    value: float
    low: float
    high: float


def efficiency(
    error_m: Array,
    bound_m: Array,
    rng: np.random.Generator,
    *,
    probability: float = 0.95,
    resamples: int = 4000,
) -> Efficiency:
    """Return √(mean of squared error) / √(mean of squared bound) over S seeds and T frames.

    error_m: (S, T). bound_m: (T,), or (S, T) when it differs between seeds. Errors of one run are correlated in time,
    so whole seeds are drawn with replacement, never single frames (percentile bootstrap). Raises ValueError when a
    figure is not finite, which a mean would hide.
    """
    error_m = np.atleast_2d(error_m)
    if not (np.isfinite(error_m).all() and np.isfinite(bound_m).all()):
        raise ValueError("errors and bounds must be finite")
    squared = np.square(error_m).mean(axis=1)
    limit = np.square(np.broadcast_to(bound_m, error_m.shape)).mean(axis=1)
    drawn = rng.integers(len(squared), size=(resamples, len(squared)))
    ratios = np.sqrt(squared[drawn].sum(axis=1) / limit[drawn].sum(axis=1))
    low, high = np.quantile(ratios, [(1 - probability) / 2, (1 + probability) / 2])
    return Efficiency(float(np.sqrt(squared.sum() / limit.sum())), float(low), float(high))
