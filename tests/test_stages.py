"""Weighing in stages: how much is taken at once, and what the kernel does to a cloud."""

from __future__ import annotations

import numpy as np
import pytest

from localiser import particles
from localiser.edges import Edges
from localiser.geometry import Array, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.mcl import Mcl, MclParameters, weigh
from localiser.particles import Particles

SIGMA = np.array([0.1, 0.1, 0.05])


class Peak:
    """A normal likelihood over the pose, much sharper than the cloud."""

    def __init__(self, mean: Array, sigma: Array) -> None:
        self.mean, self.sigma = mean, sigma

    def log_likelihood(self, particles: Particles, edges: Edges, landmark_map: LandmarkMap) -> Array:
        residual = particles.poses - self.mean
        residual[:, 2] = wrap_angle(residual[:, 2])
        return np.asarray(-0.5 * np.square(residual / self.sigma).sum(axis=1))


def cloud(seed: int, count: int = 2000, heading: float = 0.0) -> Particles:
    rng = np.random.default_rng(seed)
    return particles.from_gaussian(np.array([0.0, 0.0, heading]), np.diag(SIGMA**2), count, rng)


def filter_with(peak: Peak, stage_below: float = 0.3) -> Mcl:
    return Mcl(LandmarkMap.from_points(np.zeros((1, 2))), peak, MclParameters(stage_below=stage_below))


def test_all_is_taken_where_enough_samples_stay_effective() -> None:
    assert particles.largest_step(np.zeros(100), np.linspace(0, 0.1, 100), 1.0, 50.0) == 1.0


def test_a_step_leaves_just_as_many_effective_samples_as_asked() -> None:
    moved = cloud(0)
    log_likelihood = Peak(np.zeros(3), SIGMA / 20).log_likelihood(
        moved, Edges.none(), LandmarkMap.from_points(np.zeros((1, 2)))
    )
    step = particles.largest_step(moved.log_weight, log_likelihood, 1.0, 200.0)
    assert 0 < step < 1
    ess = particles.effective_sample_size(particles.normalised(step * log_likelihood))
    assert ess == pytest.approx(200.0, rel=1e-3)


@pytest.mark.parametrize("heading", [0.0, np.pi - 0.01])
def test_spreading_keeps_mean_and_covariance(heading: float) -> None:
    before = cloud(1, 20_000, heading)
    after = particles.spread(before, np.random.default_rng(2))
    old, new = particles.estimate(before), particles.estimate(after)
    # Draws of a kernel of width h move the mean by h σ/√N and the variance by about 2 h √(2/N): 4 standard errors.
    width = 20_000 ** (-1 / 7)
    assert np.abs(wrap_angle(new.mean - old.mean) / SIGMA).max() < 4 * width / np.sqrt(20_000)
    assert np.diag(new.cov) / np.diag(old.cov) == pytest.approx(np.ones(3), abs=4 * 2 * width * np.sqrt(2 / 20_000))
    assert len(np.unique(after["x"])) == 20_000


def test_stages_find_the_posterior_that_one_step_has_no_particles_for() -> None:
    # Prior N(0, Σ), likelihood N(μ, Σ/40²) two sigmas off: the posterior is known in closed form.
    mean, sharp = 2 * SIGMA, SIGMA / 40
    shrink = 1 / (1 + 1 / 40**2)
    errors, ratios = [], []
    for seed in range(30):
        found = weigh(filter_with(Peak(mean, sharp)), cloud(seed), Edges.none(), 1.0, np.random.default_rng(seed))
        estimate = particles.estimate(found)
        errors.append((estimate.mean - shrink * mean) / sharp)
        ratios.append(np.diag(estimate.cov) / (shrink * sharp**2))
    # The kernel is an approximation: within half of the posterior's sigma, where one step is off by twenty of them.
    assert np.sqrt(np.mean(np.square(errors))) < 0.5
    assert np.median(ratios, axis=0) == pytest.approx(np.ones(3), abs=0.15)


def test_one_step_alone_collapses_on_the_same_posterior() -> None:
    peak = Peak(2 * SIGMA, SIGMA / 40)
    found = weigh(filter_with(peak, 0.0), cloud(0), Edges.none(), 1.0, np.random.default_rng(0))
    assert particles.effective_sample_size(found.weight) < 5
    error = (particles.estimate(found).mean - 2 * SIGMA) / (SIGMA / 40)
    assert np.abs(error).max() > 10


def test_stages_come_to_an_end_when_no_step_leaves_enough() -> None:
    peak = Peak(np.array([50.0, 0.0, 0.0]), np.array([1e-4, 1e-4, 1e-4]))
    found = weigh(filter_with(peak, 0.9), cloud(0, 50), Edges.none(), 1.0, np.random.default_rng(0))
    assert np.isfinite(found.columns).all()
