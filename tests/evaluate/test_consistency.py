"""NEES and its bands."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.evaluate import fraction_inside, nees, nees_band

COV = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.004], [0.002, -0.004, 0.01]])


def test_nees_is_the_quadratic_form() -> None:
    rng = np.random.default_rng(0)
    error = rng.normal(size=(50, 3))
    expected = [e @ np.linalg.inv(COV) @ e for e in error]
    np.testing.assert_allclose(nees(error, np.tile(COV, (50, 1, 1))), expected, rtol=1e-10)


def test_nees_of_consistent_errors_follows_chi_square() -> None:
    rng = np.random.default_rng(1)
    values = nees(rng.multivariate_normal(np.zeros(3), COV, 20_000), np.tile(COV, (20_000, 1, 1)))
    assert values.mean() == pytest.approx(3, abs=0.06)
    assert fraction_inside(values) == pytest.approx(0.95, abs=0.006)


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_wrong_confidence_falls_outside_the_band(scale: float) -> None:
    rng = np.random.default_rng(2)
    errors = rng.multivariate_normal(np.zeros(3), COV, (50, 200))
    stated = np.tile(COV * scale, (200, 1, 1))
    values = np.array([nees(run, stated) for run in errors])
    assert fraction_inside(values) < 0.05


def test_averaged_over_seeds_the_band_holds_95_percent() -> None:
    rng = np.random.default_rng(3)
    errors = rng.multivariate_normal(np.zeros(3), COV, (50, 4000))
    values = np.array([nees(run, np.tile(COV, (4000, 1, 1))) for run in errors])
    assert fraction_inside(values) == pytest.approx(0.95, abs=0.015)


@pytest.mark.parametrize(
    ("runs", "dimensions", "band"),
    [  # χ² tables: 3 and 2 degrees of freedom at 0.025 and 0.975; 30 degrees, divided by 10 runs
        (1, 3, (0.2158, 9.3484)),
        (1, 2, (0.0506, 7.3778)),
        (10, 3, (1.6791, 4.6979)),
    ],
)
def test_band_is_that_of_the_tables(runs: int, dimensions: int, band: tuple[float, float]) -> None:
    assert nees_band(runs, dimensions) == pytest.approx(band, abs=1e-4)


def test_unknown_or_singular_covariances_have_no_nees() -> None:
    covs = np.stack([COV, np.zeros((3, 3)), np.diag([1.0, 1.0, 0.0]), np.full((3, 3), np.nan), COV])
    errors = np.ones((5, 3))
    errors[4] = np.nan
    np.testing.assert_array_equal(np.isfinite(nees(errors, covs)), [True, False, False, False, False])
    assert np.isnan(fraction_inside(np.full((2, 5), np.nan)))
