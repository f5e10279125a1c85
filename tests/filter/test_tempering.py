"""Tempering in stages: how much is taken at once, what the kernel does to a cloud; and the oracle of the filter."""

import numpy as np
import pytest
from grid_filter import GridFilter, headings

from localiser import particles
from localiser.filter.tempering import weighed_in_stages
from localiser.geometry import Array, Increment, compose, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.observation import INLIER_RATES, EdgeObservation, InlierRate, Sighting
from localiser.particles import Particles

SIGMA = np.array([0.1, 0.1, 0.05])


class Peak(EdgeObservation):
    """A normal likelihood of the pose. Angles stand for what they do to it: one radian is as wide as the cloud."""

    def __init__(self, mean: Array, sharpness: float) -> None:
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "sharpness", sharpness)

    def log_likelihood(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> Array:
        return np.asarray(self.by_rate(particles, sighting, landmark_map)[0])

    def by_rate(
        self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap, blur_rad: float = 0.0
    ) -> Array:
        residual = particles.poses - self.mean
        residual[:, 2] = wrap_angle(residual[:, 2])
        sigma = SIGMA * np.hypot(self.sharpness, blur_rad)
        one = -0.5 * np.square(residual / sigma).sum(axis=1) - np.log(sigma).sum()
        return np.tile(one, (len(INLIER_RATES), 1))

    def scales(self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap) -> tuple[float, float]:
        return 1.0, self.sharpness


def cloud(seed: int, count: int = 2000, heading: float = 0.0) -> Particles:
    rng = np.random.default_rng(seed)
    return particles.from_gaussian(np.array([0.0, 0.0, heading]), np.diag(SIGMA**2), count, rng)


def test_all_is_taken_where_enough_samples_stay_effective() -> None:
    assert particles.largest_step(np.zeros(100), np.linspace(0, 0.1, 100), 1.0, 50.0) == 1.0


def test_a_step_leaves_just_as_many_effective_samples_as_asked() -> None:
    moved = cloud(0)
    peak = Peak(np.zeros(3), 1 / 20)
    log_likelihood = peak.log_likelihood(moved, Sighting(0), LandmarkMap.from_points(np.zeros((1, 2))))
    step = particles.largest_step(np.zeros(len(moved)), log_likelihood, 1.0, 200.0)
    assert 0 < step < 1
    ess = particles.effective_sample_size(particles.normalised(step * log_likelihood))
    assert ess == pytest.approx(200.0, rel=1e-3)


@pytest.mark.parametrize("heading", [0.0, np.pi - 0.01])
def test_spreading_keeps_mean_and_covariance(heading: float) -> None:
    before = cloud(1, 20_000, heading)
    after = particles.spread(before, np.random.default_rng(2))
    old, new = before.estimate, after.estimate
    # Draws of a kernel of width h move the mean by h σ/√N and the variance by about 2 h √(2/N): 4 standard errors.
    width = 20_000 ** (-1 / 7)
    assert np.abs(wrap_angle(new.mean - old.mean) / SIGMA).max() < 4 * width / np.sqrt(20_000)
    assert np.diag(new.cov) / np.diag(old.cov) == pytest.approx(np.ones(3), abs=4 * 2 * width * np.sqrt(2 / 20_000))
    assert len(np.unique(after["x"])) == 20_000


def weighed(peak: Peak, cloud: Particles, *, first: bool = False, stage_below: float = 0.3, seed: int = 0) -> Particles:
    landmark_map = LandmarkMap.from_points(np.zeros((1, 2)))
    rng, unknown = np.random.default_rng(seed), InlierRate.unknown()
    found = weighed_in_stages(cloud, peak, Sighting(0), landmark_map, unknown, 1.0, stage_below, rng, is_first=first)
    return found.particles


@pytest.mark.parametrize("sharpness", [1 / 4, 1 / 40])
def test_stages_find_the_posterior_that_one_step_has_no_particles_for(sharpness: float) -> None:
    # Prior N(0, Σ), likelihood N(μ, Σ sharpness²) two sigmas off: the posterior is known in closed form.
    shrink = 1 / (1 + sharpness**2)
    errors, ratios = [], []
    for seed in range(30):
        found = weighed(Peak(2 * SIGMA, sharpness), cloud(seed), first=True, seed=seed)
        estimate = found.estimate
        errors.append((estimate.mean - shrink * 2 * SIGMA) / (sharpness * SIGMA))
        ratios.append(np.diag(estimate.cov) / (shrink * (sharpness * SIGMA) ** 2))
    # In the prior's tail, 3.5 sigmas out, particles are few: within one of the posterior's sigmas, not twenty.
    assert np.sqrt(np.mean(np.square(errors))) < 0.8
    assert np.median(ratios, axis=0) == pytest.approx(np.ones(3), abs=0.15)


def test_stages_alone_also_find_a_posterior_that_is_not_in_the_tail() -> None:
    errors = []
    for seed in range(30):
        estimate = weighed(Peak(SIGMA, 1 / 20), cloud(seed), seed=seed).estimate
        errors.append((estimate.mean - SIGMA) / (SIGMA / 20))
    assert np.sqrt(np.mean(np.square(errors))) < 0.5


def test_one_step_alone_collapses_on_the_same_posterior() -> None:
    found = weighed(Peak(2 * SIGMA, 1 / 40), cloud(0), stage_below=0.0)
    assert particles.effective_sample_size(found.weight) < 5
    error = (found.estimate.mean - 2 * SIGMA) / (SIGMA / 40)
    assert np.abs(error).max() > 10


def test_the_first_image_is_weighed_in_stages_even_where_all_particles_fit_alike() -> None:
    # Far off, a likelihood with a floor (clutter) is flat over all particles: their effective number says nothing.
    class Floored(Peak):
        def by_rate(self, *arguments: object, **keywords: object) -> Array:
            return np.logaddexp(super().by_rate(*arguments, **keywords), -20.0)  # type: ignore[arg-type]

    peak = Floored(2 * SIGMA, 1 / 40)
    later, first = (weighed(peak, cloud(4), first=first) for first in (False, True))
    off = [np.abs((found.estimate.mean - 2 * SIGMA) / SIGMA).max() for found in (later, first)]
    assert off[0] > 1.0
    assert off[1] < 0.2


def test_stages_come_to_an_end_however_sharp_the_edges() -> None:
    found = weighed(Peak(np.array([50.0, 0.0, 0.0]), 1e-7), cloud(0, 50), stage_below=0.9)
    assert np.isfinite(found.columns).all()


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
