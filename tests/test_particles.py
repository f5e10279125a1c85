"""Weights, resampling and estimate, against filterpy, numpy and the statistics they claim."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from localiser.geometry import wrap_angle
from localiser.particles import (
    POSE,
    Particles,
    effective_sample_size,
    estimate,
    from_gaussian,
    normalised,
    systematic_resample,
    take,
)

settings.register_profile("localiser", derandomize=True, deadline=None, max_examples=100)
settings.load_profile("localiser")

ALMOST_ONE = np.nextafter(1.0, 0.0)
weights = st.lists(st.floats(0, 1), min_size=1, max_size=60).map(np.array).filter(lambda w: w.sum() > 1e-3)


class Draw:
    """A generator whose uniform draw is known."""

    def __init__(self, uniform):
        self.uniform = uniform

    def random(self):
        return self.uniform


def offspring(weight, count, uniform):
    return np.bincount(systematic_resample(weight, count, Draw(uniform)), minlength=len(weight))


def particles_of(columns, log_weight=None, names=POSE, circular=("heading",)):
    columns = np.asarray(columns, dtype=np.float64)
    log_weight = np.zeros(columns.shape[1]) if log_weight is None else np.asarray(log_weight, dtype=np.float64)
    return Particles(tuple(names), columns, log_weight, frozenset(circular))


# -- weights ----------------------------------------------------------------------------------------------------------


@given(log_weight=st.lists(st.floats(-50, 50), min_size=1, max_size=20).map(np.array), shift=st.floats(-1e5, 1e5))
def test_weights_sum_to_one_whatever_the_common_constant(log_weight, shift):
    weight = normalised(log_weight)
    assert weight.sum() == pytest.approx(1)
    # Adding 1e5 rounds each logarithm by 1e-11.
    np.testing.assert_allclose(normalised(log_weight + shift), weight, rtol=1e-10)
    np.testing.assert_allclose(weight, np.exp(log_weight) / np.exp(log_weight).sum(), rtol=1e-12)


@pytest.mark.parametrize("common", [-1e300, -1e4, 1e4, 1e300])
def test_huge_log_weights_neither_overflow_nor_vanish(common):
    np.testing.assert_array_equal(normalised(np.array([common, common, -np.inf])), [0.5, 0.5, 0])


@pytest.mark.parametrize("log_weight", [[-np.inf, -np.inf], [0.0, np.nan], [0.0, np.inf], []])
def test_weights_that_cannot_be_normalised_are_refused(log_weight):
    with pytest.raises(ValueError, match="weight"):
        normalised(np.array(log_weight))


def test_effective_sample_size_counts_particles_that_matter():
    assert effective_sample_size(np.full(8, 1 / 8)) == pytest.approx(8)
    assert effective_sample_size(np.array([0.0, 1.0, 0.0])) == 1
    assert effective_sample_size(np.array([0.5, 0.5, 0, 0])) == pytest.approx(2)


# -- systematic resampling --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 7, 500])
@pytest.mark.parametrize("seed", range(5))
def test_indices_are_those_of_filterpy_for_the_same_draw(count, seed, monkeypatch):
    from filterpy.monte_carlo import resampling

    weight = np.random.default_rng(seed).dirichlet(np.full(count, 0.3))
    monkeypatch.setattr(resampling, "random", np.random.default_rng(seed + 100).random)
    expected = resampling.systematic_resample(weight)
    np.testing.assert_array_equal(systematic_resample(weight, count, np.random.default_rng(seed + 100)), expected)


@given(weight=weights, count=st.integers(1, 200), uniform=st.floats(0, ALMOST_ONE))
def test_offspring_is_floor_or_ceiling_of_the_share(weight, count, uniform):
    share = count * weight / weight.sum()
    found = offspring(weight, count, uniform)
    assert found.sum() == count
    assert (np.abs(found - share) < 1 + 1e-9).all()  # 1e-9: a share that is a whole number up to rounding
    assert (found[weight == 0] == 0).all()


@given(weight=weights, count=st.integers(1, 50))
def test_mean_offspring_over_all_draws_is_the_share(weight, count):
    draws = (np.arange(400) + 0.5) / 400
    mean = np.mean([offspring(weight, count, uniform) for uniform in draws], axis=0)
    # Offspring changes at two draws at most; a grid of 400 draws places each within half a step.
    np.testing.assert_allclose(mean, count * weight / weight.sum(), atol=1 / 400 + 1e-9)


def test_mean_offspring_over_seeds_is_the_share():
    weight, count, seeds = np.array([0.5, 0.3, 0.15, 0.05, 0.0]), 13, 4000
    found = np.array(
        [np.bincount(systematic_resample(weight, count, np.random.default_rng(s)), minlength=5) for s in range(seeds)]
    )
    share = count * weight
    # Floor plus one with probability of the fraction; 4 standard errors.
    fraction = share % 1
    assert (np.abs(found.mean(axis=0) - share) <= 4 * np.sqrt(fraction * (1 - fraction) / seeds) + 1e-12).all()


@pytest.mark.parametrize("uniform", [0.0, 0.5, ALMOST_ONE])
@pytest.mark.parametrize("where", [0, 2, 4])
def test_all_weight_on_one_particle(where, uniform):
    weight = np.zeros(5)
    weight[where] = 0.7
    np.testing.assert_array_equal(systematic_resample(weight, 9, Draw(uniform)), np.full(9, where))


def test_cumulative_sum_below_one():
    weight = np.append(np.full(10, 0.1), 0.0)
    assert np.cumsum(weight)[-1] < 1
    np.testing.assert_array_equal(systematic_resample(weight, 10, Draw(0.5)), np.arange(10))
    assert systematic_resample(weight, 10, Draw(ALMOST_ONE)).max() == 9  # not the last, which has no weight


@given(count=st.integers(1, 3000), scale=st.floats(1e-300, 1e300))
def test_last_tooth_of_the_comb_stays_among_particles_with_weight(count, scale):
    weight = np.array([1.0, 1.0, 1.0, 0.0]) * scale / 3
    assert systematic_resample(weight, count, Draw(ALMOST_ONE)).max() <= 2


@pytest.mark.parametrize("uniform", [0.0, 0.3, ALMOST_ONE])
def test_one_particle_has_all_offspring(uniform):
    np.testing.assert_array_equal(systematic_resample(np.array([0.2]), 4, Draw(uniform)), [0, 0, 0, 0])


def test_weights_need_not_sum_to_one():
    weight = np.random.default_rng(0).random(50)
    expected = systematic_resample(weight / weight.sum(), 50, Draw(0.37))
    np.testing.assert_array_equal(systematic_resample(weight * 12.5, 50, Draw(0.37)), expected)


@pytest.mark.parametrize("weight", [[0.0, 0.0], [0.5, np.nan], [0.5, np.inf]])
def test_weights_with_no_sum_are_refused(weight):
    with pytest.raises(ValueError, match="sum"):
        systematic_resample(np.array(weight), 2, np.random.default_rng(0))


def test_resampled_particles_are_copies_of_equal_weight():
    particles = particles_of(
        np.arange(12.0).reshape(4, 3), [0.0, -1.0, -2.0], names=(*POSE, "scale"), circular=("heading",)
    )
    taken = take(particles, np.array([2, 2, 0]))
    np.testing.assert_array_equal(taken["scale"], [11, 11, 9])
    np.testing.assert_array_equal(taken.poses, particles.poses[[2, 2, 0]])
    np.testing.assert_allclose(taken.weight, 1 / 3)
    assert (taken.names, taken.circular) == (particles.names, particles.circular)


# -- estimate ---------------------------------------------------------------------------------------------------------


def test_mean_and_covariance_are_numpys_with_weights():
    rng = np.random.default_rng(3)
    names = (*POSE, "scale", "veer")
    columns, log_weight = rng.normal(0, [[2], [1], [0.05], [0.1], [0.3]], (5, 400)), rng.normal(0, 1, 400)
    columns[3] += columns[0]
    found = estimate(particles_of(columns, log_weight, names))
    weight = np.exp(log_weight)
    assert found.names == names
    straight = [0, 1, 3, 4]
    np.testing.assert_allclose(found.mean[straight], np.average(columns[straight], axis=1, weights=weight))
    np.testing.assert_allclose(
        found.cov[np.ix_(straight, straight)], np.cov(columns[straight], aweights=weight, ddof=0), rtol=1e-9, atol=1e-12
    )
    # The mean direction differs from the arithmetic mean by the third moment, 0.05³ here.
    np.testing.assert_allclose(found.mean[2], np.average(columns[2], weights=weight), atol=2e-4)
    np.testing.assert_allclose(found.cov[2], np.cov(columns, aweights=weight, ddof=0)[2], atol=1e-6)


@given(turn=st.floats(-np.pi, np.pi))
def test_turning_every_angle_turns_the_mean_and_leaves_the_covariance(turn):
    rng = np.random.default_rng(4)
    columns, names = rng.normal(0, 0.3, (5, 50)), (*POSE, "camera_yaw", "veer")
    log_weight, circular = rng.normal(0, 1, 50), ("heading", "camera_yaw")
    turned = columns.copy()
    turned[2:4] = wrap_angle(columns[2:4] + turn)
    still = estimate(particles_of(columns, log_weight, names, circular))
    found = estimate(particles_of(turned, log_weight, names, circular))
    np.testing.assert_allclose(wrap_angle(found.mean[2:4] - still.mean[2:4] - turn), 0, atol=1e-12)
    np.testing.assert_allclose(found.mean[[0, 1, 4]], still.mean[[0, 1, 4]])
    np.testing.assert_allclose(found.cov, still.cov, atol=1e-12)


def test_only_circular_columns_are_wrapped():
    columns = np.array([[3.0, -3.0], [0.0, 0.0], [3.0, -3.0], [3.0, -3.0]])
    found = estimate(particles_of(columns, names=(*POSE, "veer")))
    assert abs(found.mean[2]) == pytest.approx(np.pi)
    assert found.mean[0] == found.mean[3] == 0
    assert found.pose_cov[0, 0] == found.cov[3, 3] == 9
    assert found.pose_cov[2, 2] == pytest.approx((np.pi - 3) ** 2)


def test_particles_without_weight_do_not_count():
    found = estimate(particles_of([[1, 100], [2, 100], [0.3, 2.0]], [0.0, -np.inf]))
    np.testing.assert_allclose(found.pose, [1, 2, 0.3])
    np.testing.assert_allclose(found.pose_cov, 0, atol=1e-15)


# -- drawing from a Gaussian ------------------------------------------------------------------------------------------


def test_drawn_particles_have_the_mean_and_covariance_asked_for():
    mean, count = np.array([2.0, -1.0, np.pi - 0.01]), 40_000
    cov = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.0025]])
    particles = from_gaussian(mean, cov, count, np.random.default_rng(5))
    assert len(particles) == count
    assert (np.abs(particles["heading"]) <= np.pi).all()
    found = estimate(particles)
    # 4 standard errors: √(C_ii / n) of a mean, √((C_ii C_jj + C_ij²) / n) of a covariance.
    variance = np.diag(cov)
    assert abs(wrap_angle(found.mean[2] - mean[2])) < 4 * np.sqrt(variance[2] / count)
    assert (np.abs(found.mean[:2] - mean[:2]) < 4 * np.sqrt(variance[:2] / count)).all()
    assert (np.abs(found.cov - cov) < 4 * np.sqrt((np.outer(variance, variance) + cov**2) / count)).all()


def test_start_that_is_known_exactly_gives_equal_particles():
    mean = np.array([1.0, 2.0, 0.5])
    particles = from_gaussian(mean, np.zeros((3, 3)), 5, np.random.default_rng(6))
    np.testing.assert_array_equal(particles.poses, np.tile(mean, (5, 1)))


def test_singular_covariance_spreads_along_its_axis_only():
    along = np.array([0.6, -0.8, 0.0])
    particles = from_gaussian(np.zeros(3), 0.25 * np.outer(along, along), 2000, np.random.default_rng(7))
    np.testing.assert_allclose(np.cross(particles.poses, along), 0, atol=1e-7)  # √ of an eigenvalue's rounding
    # 2000 samples: 1.6 %, 4 sigma.
    assert (particles.poses @ along).std() == pytest.approx(0.5, rel=0.065)


def test_the_generator_alone_decides_the_draw():
    draws = [from_gaussian(np.zeros(3), np.eye(3), 4, np.random.default_rng(seed)).columns for seed in (1, 1, 2)]
    np.testing.assert_array_equal(draws[0], draws[1])
    assert not np.allclose(draws[0], draws[2])


def test_columns_are_found_by_name():
    particles = particles_of(np.arange(8.0).reshape(4, 2), names=("x", "z", "heading", "scale"))
    np.testing.assert_array_equal(particles["scale"], [6, 7])
    np.testing.assert_array_equal(particles.poses, [[0, 2, 4], [1, 3, 5]])
    with pytest.raises(ValueError, match="not in"):
        _ = particles["tilt"]
