"""The density that particles are drawn from: it sums to one, and weights make draws from it right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localiser.geometry import wrap_angle
from localiser.relocalisation import Proposals, Region

REGION = Region((-2.0, 3.0), (-1.0, 1.5))
MEAN = np.array([[0.0, 0.0, 3.1], [1.5, 0.5, -1.0]])
COV = np.array([np.diag([0.04, 0.02, 0.01]), [[0.05, 0.02, 0.0], [0.02, 0.03, 0.01], [0.0, 0.01, 0.02]]])
MIXTURE = Proposals(np.log([0.7, 0.3]), MEAN, COV, REGION, even=0.2)


def test_density_sums_to_one():
    x, z = np.linspace(-3, 4, 71), np.linspace(-2, 2.5, 46)
    heading = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    # Off the border of the region by half a cell, where the even share ends.
    grid = np.stack(np.meshgrid(x + 0.05, z + 0.05, heading, indexing="ij"), axis=-1).reshape(-1, 3)
    assert np.exp(MIXTURE.log_density(grid)).sum() * 0.1 * 0.1 * (2 * np.pi / 90) == pytest.approx(1, abs=2e-3)


def test_draws_have_the_density_of_the_mixture():
    """Moments of what lies near one component, of 20 000 draws, within four standard errors."""
    poses, log_weight = MIXTURE.drawn(20_000, np.random.default_rng(0))
    assert np.isfinite(log_weight).mean() > 0.97
    error = poses - MEAN[0]
    error[:, 2] = wrap_angle(error[:, 2])
    near = np.einsum("ni,ij,nj->n", error, np.linalg.inv(COV[0]), error) < 16
    share = 0.8 * 0.7
    assert near.mean() == pytest.approx(share, abs=0.02)  # 0.2 % of the even draws fall in there too
    np.testing.assert_allclose(np.cov(error[near].T), COV[0], atol=0.003)


def test_weights_turn_draws_into_the_prior():
    """E_q[prior / q] = 1 and E_q[prior / q · f] = E_prior[f], within four standard errors of 40 000 draws."""
    poses, log_weight = MIXTURE.drawn(40_000, np.random.default_rng(1))
    weight = np.exp(log_weight)
    assert weight.max() <= 1 / 0.2 + 1e-9  # the even share bounds them
    for value, expected in ((np.ones(len(poses)), 1.0), (poses[:, 0], 0.5), (poses[:, 1], 0.25), (poses[:, 2], 0.0)):
        sample = weight * value
        assert abs(sample.mean() - expected) < 4 * sample.std() / np.sqrt(len(sample))


def test_weighted_draws_are_draws_from_the_posterior():
    """A likelihood that is a Gaussian beside one component: mean and evidence in closed form."""
    centre, sigma = np.array([1.4, 0.4, -0.9]), np.array([0.1, 0.1, 0.05])
    poses, log_weight = MIXTURE.drawn(40_000, np.random.default_rng(2))
    log_weight = log_weight - 0.5 * (((poses - centre) / sigma) ** 2).sum(axis=1)
    weight = np.exp(log_weight)
    evidence = np.exp(REGION.log_density) * (2 * np.pi) ** 1.5 * sigma.prod()
    assert weight.mean() == pytest.approx(evidence, rel=0.05)
    weight /= weight.sum()
    np.testing.assert_allclose(weight @ poses, centre, atol=0.01)
    np.testing.assert_allclose(np.sqrt(weight @ (poses - centre) ** 2), sigma, rtol=0.06)


def test_knowing_nothing_is_even_and_weighs_nothing():
    poses, log_weight = Proposals.blind(REGION).drawn(2000, np.random.default_rng(3))
    np.testing.assert_allclose(log_weight, 0.0, atol=1e-12)
    assert REGION.contains(poses).all()
    np.testing.assert_allclose(poses.mean(axis=0), [0.5, 0.25, 0.0], atol=0.15)


def test_expected_hits_of_even_draws_are_how_many_are_near_a_pose():
    blind, pose = Proposals.blind(REGION), np.array([0.5, 0.25, 1.0])
    poses, _ = blind.drawn(200_000, np.random.default_rng(5))
    near = np.hypot(*(poses[:, :2] - pose[:2]).T) < 0.3
    near &= np.abs(wrap_angle(poses[:, 2] - pose[2])) < np.radians(6.0)
    assert blind.expected_hits(200_000) == pytest.approx(near.sum(), rel=0.1)
    assert replace(MIXTURE, hits=3.0).expected_hits(0) == 3.0


def test_draws_outside_the_region_weigh_nothing():
    outside = Proposals(np.zeros(1), np.array([[10.0, 0.0, 0.0]]), COV[:1], REGION, even=0.1)
    poses, log_weight = outside.drawn(500, np.random.default_rng(4))
    np.testing.assert_array_equal(np.isneginf(log_weight), ~REGION.contains(poses))
    assert 0.05 < REGION.contains(poses).mean() < 0.15
