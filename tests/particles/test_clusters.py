"""Clusters: places that are apart stay apart, what touches is one, and the sums add up."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from localiser.geometry import wrap_angle
from localiser.particles import POSE, Particles, estimate
from localiser.particles.clusters import find_clusters


def cloud(mean, sigma, count, seed):
    poses = np.random.default_rng(seed).normal(mean, sigma, (count, 3))
    poses[:, 2] = wrap_angle(poses[:, 2])
    return poses


def three_places():
    places = [([0, 0, 0], 500), ([0, 0, np.pi], 300), ([5, -3, 1], 200)]
    clouds = [cloud(mean, [0.1, 0.1, 0.05], count, seed) for seed, (mean, count) in enumerate(places)]
    return np.concatenate(clouds), np.repeat([0, 1, 2], [500, 300, 200])


def test_finds_three_places_by_weight_with_mean_and_covariance():
    """Two of them are at the same point and face opposite ways; one of these two lies across ±π."""
    poses, place = three_places()
    found = find_clusters(poses, np.ones(1000), mass=1.0)
    np.testing.assert_allclose(found.weight, [0.5, 0.3, 0.2])
    np.testing.assert_array_equal(found.count, [500, 300, 200])
    np.testing.assert_array_equal(found.label, place)
    for cluster in range(3):
        own = poses[place == cluster]
        oracle = estimate(Particles(POSE, own.T, np.zeros(len(own))))
        np.testing.assert_allclose(wrap_angle(found.mean[cluster] - oracle.mean), 0, atol=1e-12)
        np.testing.assert_allclose(found.cov[cluster], oracle.cov, atol=1e-12)


def test_weights_count_and_poses_without_weight_do_not():
    poses, place = three_places()
    weight = np.array([0.0, 1.0, 6.0])[place]
    found = find_clusters(poses, weight, mass=1.0)
    np.testing.assert_allclose(found.weight, [0.8, 0.2])
    np.testing.assert_allclose(found.mean[0], [5, -3, 1], atol=0.03)
    assert (found.label[place == 0] == -1).all()


def test_a_thin_trail_joins_nothing():
    ends = np.concatenate([cloud([0, 0, 0], 0.05, 500, 1), cloud([4, 0, 0], 0.05, 500, 2)])
    trail = np.zeros((41, 3))
    trail[:, 0] = np.linspace(0, 4, 41)
    poses = np.concatenate([ends, trail])
    assert len(find_clusters(poses, np.ones(len(poses)), mass=1.0)) == 1
    found = find_clusters(poses, np.ones(len(poses)))
    assert len(found) == 2
    assert 0.95 <= found.weight.sum() < 1


def test_a_winding_chain_is_one_cluster():
    """A spiral of cells, each touching the next only: labels have to travel along all of it."""
    angle = np.sqrt(np.linspace(1, 3000, 4000))
    spiral = np.stack([0.3 * angle * np.cos(angle), 0.3 * angle * np.sin(angle), np.zeros_like(angle)], axis=-1)
    assert len(find_clusters(spiral, np.ones(len(spiral)), mass=1.0)) == 1


def plain(poses, cell_m, around):
    """Connected cells by flood fill, one cell after the other."""
    sector = np.floor(poses[:, 2] / (2 * np.pi / around)).astype(int) % around
    cells = [(*place, turn) for place, turn in zip(np.floor(poses[:, :2] / cell_m).astype(int), sector, strict=True)]
    part = {}
    for cell in cells:
        queue = [] if cell in part else [cell]
        while queue:
            x, z, turn = queue.pop()
            part[x, z, turn] = cell
            beside = [(x + i, z + j, (turn + k) % around) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)]
            queue += [other for other in beside if other in set(cells) and other not in part]
    return [part[cell] for cell in cells]


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 40), around=st.sampled_from([1, 2, 3, 12]))
def test_agrees_with_a_flood_fill(seed, count, around):
    poses = np.random.default_rng(seed).uniform([-2, -2, -np.pi], [2, 2, np.pi], (count, 3))
    label = find_clusters(poses, np.ones(count), cell_m=0.5, cell_rad=2 * np.pi / around, mass=1.0).label
    oracle = plain(poses, 0.5, around)
    same = [[one == other for other in oracle] for one in oracle]
    np.testing.assert_array_equal(label[:, None] == label[None, :], same)


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 200), mass=st.floats(0.1, 1))
def test_sums_add_up_and_clusters_are_sorted(seed, count, mass):
    rng = np.random.default_rng(seed)
    poses = rng.uniform([-3, -3, -np.pi], [3, 3, np.pi], (count, 3))
    weight = rng.exponential(size=count)
    found = find_clusters(poses, weight, mass=mass)
    assert mass - 1e-9 <= found.weight.sum() <= 1 + 1e-9
    assert (np.diff(found.weight) <= 0).all()
    np.testing.assert_array_equal(np.bincount(found.label + 1, minlength=len(found) + 1)[1:], found.count)
    assert (np.linalg.eigvalsh(found.cov) > -1e-12).all()


@pytest.mark.parametrize("weight", [[0.0, 0.0], [np.nan, 1.0], [np.inf, 1.0]])
def test_weights_that_mean_nothing_are_refused(weight):
    with pytest.raises(ValueError, match="weights"):
        find_clusters(np.zeros((2, 3)), np.array(weight))


def test_cells_without_extent_are_refused():
    with pytest.raises(ValueError, match="cells"):
        find_clusters(np.zeros((1, 3)), np.ones(1), cell_m=0.0)


def test_places_a_world_apart_are_those_of_a_small_box():
    rng = np.random.default_rng(0)
    poses, weight = rng.normal(0, [0.2, 0.2, 0.1], (400, 3)), rng.random(400)
    alone = find_clusters(poses, weight)
    far = find_clusters(np.vstack([poses, [1e5, 1e5, 0.0]]), np.append(weight, 0.0))
    np.testing.assert_array_equal(far.label, [*alone.label, -1])
    np.testing.assert_allclose(far.mean, alone.mean, atol=1e-12)
    np.testing.assert_allclose(far.cov, alone.cov, atol=1e-12)
