"""RMSE over bound, with its bootstrap interval."""

from __future__ import annotations

import numpy as np
import pytest
from efficiency import efficiency


def rayleigh(rng: np.random.Generator, seeds: int, bound_m: np.ndarray, factor: float = 1.0) -> np.ndarray:
    """Errors of an estimator whose RMS distance is `factor` times the bound; one draw a seed, so fully correlated."""
    return factor * bound_m * np.hypot(*rng.standard_normal((2, seeds, 1))) / np.sqrt(2)


def test_interval_covers_the_truth_as_often_as_it_says() -> None:
    """Frames of one run are as correlated as can be: an interval from single frames would be far too narrow."""
    rng, bound_m = np.random.default_rng(1), np.linspace(0.02, 0.1, 30)
    results = [efficiency(rayleigh(rng, 60, bound_m, 1.2), bound_m, rng, resamples=500) for _ in range(200)]
    covered = np.mean([r.low <= 1.2 <= r.high for r in results])
    assert 0.88 <= covered <= 0.98
    assert all(r.low < r.value < r.high for r in results)


def test_bounds_may_differ_between_seeds() -> None:
    rng = np.random.default_rng(2)
    bound_m = rng.uniform(0.01, 0.1, (300, 20))
    result = efficiency(bound_m.copy(), bound_m, rng)
    assert result.value == result.low == result.high == pytest.approx(1.0)


def test_a_run_that_broke_off_is_not_averaged_away() -> None:
    with pytest.raises(ValueError, match="finite"):
        efficiency(np.array([[0.1, np.nan]]), np.ones(2), np.random.default_rng(0))
