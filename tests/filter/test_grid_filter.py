"""The oracle itself, against closed forms: composition of Gaussians and the Kalman filter."""

from __future__ import annotations

import numpy as np
import pytest
from grid_filter import GridFilter, headings

from localiser.geometry import Array, Increment, compose, wrap_angle

X, Z, HEADING = np.linspace(-2, 2, 41), np.linspace(-2, 2, 41), headings(90)
COV = np.array([[0.04, 0.01, 0.004], [0.01, 0.05, -0.003], [0.004, -0.003, 0.02]])


@pytest.mark.parametrize("heading", [0.0, 1.0, np.pi - 0.05])
def test_gaussian_has_its_mean_and_covariance(heading: float) -> None:
    mean = np.array([0.3, -0.2, heading])
    grid = GridFilter.gaussian(X, Z, HEADING, mean, COV)
    assert grid.p.sum() == pytest.approx(1)
    np.testing.assert_allclose(wrap_angle(grid.mean - mean), 0, atol=1e-6)
    np.testing.assert_allclose(grid.cov, COV, atol=1e-6)


@pytest.mark.parametrize(
    "motion",
    [[0.23, 0.1, -0.4], *(pytest.param(each, marks=pytest.mark.slow) for each in ([0.0, -0.5, 0.1], [0.0, 0.0, 1.0]))],
)
def test_prediction_is_the_composition_of_the_two_distributions(motion: list[float]) -> None:
    """p(next) = ∫ p(next | pose) p(pose): mean and covariance against two million drawn pairs."""
    start, noise = np.array([0.1, 0.2, 3.0]), np.array([[4e-3, 1e-3, 2e-3], [1e-3, 9e-3, 1e-3], [2e-3, 1e-3, 6e-3]])
    grid = GridFilter.gaussian(X, Z, HEADING, start, COV).predict(Increment.from_mean(motion), noise)
    rng = np.random.default_rng(0)
    count = 2_000_000
    drawn = compose(
        rng.multivariate_normal(start, COV, count),
        np.array(motion) + rng.multivariate_normal(np.zeros(3), noise, count),
    )
    error = drawn - grid.mean
    error[:, 2] = wrap_angle(error[:, 2])
    np.testing.assert_allclose(error.mean(axis=0), 0, atol=6e-4)
    np.testing.assert_allclose(grid.cov, error.T @ error / count, atol=4e-4)


def test_update_of_a_linear_measurement_is_the_kalman_filter() -> None:
    mean, row, sigma, measured = np.array([0.0, 0.1, 0.2]), np.array([1.0, -0.5, 0.3]), 0.15, 0.25

    def log_likelihood(poses: Array) -> Array:
        return -0.5 * ((poses @ row - measured) / sigma) ** 2

    grid = GridFilter.gaussian(X, Z, HEADING, mean, COV).update(log_likelihood)
    gain = COV @ row / (row @ COV @ row + sigma**2)
    np.testing.assert_allclose(grid.mean, mean + gain * (measured - row @ mean), atol=1e-4)
    np.testing.assert_allclose(grid.cov, COV - np.outer(gain, row @ COV), atol=1e-4)


def test_constants_of_the_likelihood_do_not_matter() -> None:
    grid = GridFilter.gaussian(X, Z, HEADING, np.zeros(3), COV)
    shifted = grid.update(lambda poses: np.full(len(poses), -5000.0))
    np.testing.assert_allclose(shifted.p, grid.p, atol=1e-12)


def test_what_the_grid_cannot_hold_is_refused() -> None:
    grid = GridFilter.gaussian(X, Z, HEADING, np.zeros(3), COV)
    with pytest.raises(ValueError, match="too narrow"):
        grid.predict(Increment.from_mean(np.zeros(3)), np.diag([1e-3, 1e-3, 1e-6]))
    with pytest.raises(ValueError, match="border"):
        grid.predict(Increment.from_mean([0.0, -1.5, 0.0]), np.diag([1e-3, 1e-3, 6e-3]))
