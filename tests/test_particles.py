"""Clouds of particles: weights, estimate, kernel, resampling against filterpy; and their clusters."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from localiser.geometry import wrap_angle
from localiser.particles import (
    CELL_M,
    CELL_RAD,
    POSE,
    Particles,
    cells_of,
    effective_sample_size,
    find_clusters,
    from_gaussian,
    log_sum,
    multinomial_resample,
    normalised,
    systematic_resample,
    take,
)


def particles_of(columns, log_weight=None, names=POSE):
    columns = np.asarray(columns, dtype=np.float64)
    log_weight = np.zeros(columns.shape[1]) if log_weight is None else np.asarray(log_weight, dtype=np.float64)
    return Particles(tuple(names), columns, log_weight)


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


def test_taken_particles_are_copies_of_equal_weight():
    particles = particles_of(np.arange(12.0).reshape(4, 3), [0.0, -1.0, -2.0], names=(*POSE, "scale"))
    taken = take(particles, np.array([2, 2, 0]))
    np.testing.assert_array_equal(taken["scale"], [11, 11, 9])
    np.testing.assert_array_equal(taken.poses, particles.poses[[2, 2, 0]])
    np.testing.assert_allclose(taken.weight, 1 / 3)
    assert taken.names == particles.names


# -- estimate ---------------------------------------------------------------------------------------------------------


def test_mean_and_covariance_are_numpys_with_weights():
    rng = np.random.default_rng(3)
    names = (*POSE, "scale", "veer")
    columns, log_weight = rng.normal(0, [[2], [1], [0.05], [0.1], [0.3]], (5, 400)), rng.normal(0, 1, 400)
    columns[3] += columns[0]
    found = particles_of(columns, log_weight, names).estimate
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
def test_turning_every_heading_turns_the_mean_and_leaves_the_covariance(turn):
    rng = np.random.default_rng(4)
    columns, names, log_weight = rng.normal(0, 0.3, (4, 50)), (*POSE, "veer"), rng.normal(0, 1, 50)
    turned = columns.copy()
    turned[2] = wrap_angle(columns[2] + turn)
    still, found = (particles_of(each, log_weight, names).estimate for each in (columns, turned))
    assert wrap_angle(found.mean[2] - still.mean[2] - turn) == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(found.mean[[0, 1, 3]], still.mean[[0, 1, 3]])
    np.testing.assert_allclose(found.cov, still.cov, atol=1e-12)


def test_only_headings_are_wrapped():
    columns = np.array([[3.0, -3.0], [0.0, 0.0], [3.0, -3.0], [3.0, -3.0]])
    found = particles_of(columns, names=(*POSE, "veer")).estimate
    assert abs(found.mean[2]) == pytest.approx(np.pi)
    assert found.mean[0] == found.mean[3] == 0 and found.pose_cov[0, 0] == found.cov[3, 3] == 9
    assert found.pose_cov[2, 2] == pytest.approx((np.pi - 3) ** 2)


def test_particles_without_weight_do_not_count():
    found = particles_of([[1, 100], [2, 100], [0.3, 2.0]], [0.0, -np.inf]).estimate
    np.testing.assert_allclose(found.pose, [1, 2, 0.3])
    np.testing.assert_allclose(found.pose_cov, 0, atol=1e-15)


# -- drawing from a Gaussian ------------------------------------------------------------------------------------------


def test_drawn_particles_have_the_mean_and_covariance_asked_for():
    mean, count = np.array([2.0, -1.0, np.pi - 0.01]), 40_000
    cov = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.0025]])
    particles = from_gaussian(mean, cov, count, np.random.default_rng(5))
    assert len(particles) == count and (np.abs(particles["heading"]) <= np.pi).all()
    found = particles.estimate
    # 4 standard errors: √(C_ii / n) of a mean, √((C_ii C_jj + C_ij²) / n) of a covariance.
    variance = np.diag(cov)
    assert abs(wrap_angle(found.mean[2] - mean[2])) < 4 * np.sqrt(variance[2] / count)
    assert (np.abs(found.mean[:2] - mean[:2]) < 4 * np.sqrt(variance[:2] / count)).all()
    assert (np.abs(found.cov - cov) < 4 * np.sqrt((np.outer(variance, variance) + cov**2) / count)).all()


def test_singular_covariance_spreads_along_its_axis_only():
    along = np.array([0.6, -0.8, 0.0])
    particles = from_gaussian(np.zeros(3), 0.25 * np.outer(along, along), 2000, np.random.default_rng(7))
    np.testing.assert_allclose(np.cross(particles.poses, along), 0, atol=1e-7)  # √ of an eigenvalue's rounding
    # 2000 samples: 1.6 %, 4 sigma.
    assert (particles.poses @ along).std() == pytest.approx(0.5, rel=0.065)


@pytest.mark.parametrize("top", [0.0, -1e4, 1e4])
def test_the_logarithm_of_a_sum_neither_overflows_nor_vanishes(top):
    log_weight = top + np.append(np.random.default_rng(0).normal(0, 3, 50), -np.inf)
    assert log_sum(log_weight) == pytest.approx(np.logaddexp.reduce(log_weight), rel=1e-14)
    assert log_sum(np.full(3, -np.inf)) == -np.inf


SCHEMES = [systematic_resample, multinomial_resample]
ALMOST_ONE = np.nextafter(1.0, 0.0)
weights = st.lists(st.floats(0, 1), min_size=1, max_size=60).map(np.array).filter(lambda w: w.sum() > 1e-3)
schemes = pytest.mark.parametrize("resample", SCHEMES, ids=lambda scheme: scheme.__name__)


class Draw:
    """A generator whose uniform draws are all the same."""

    def __init__(self, uniform):
        self.uniform = uniform

    def random(self, size=None):
        return self.uniform if size is None else np.full(size, self.uniform)


@schemes
@pytest.mark.parametrize("weight", [[0.5, 0.3, 0.15, 0.05], [0.0, 3.0, 0.0, 1.0, 2.5], [1.0] * 7])
@pytest.mark.parametrize("count", [4, 5, 17])
def test_mean_offspring_is_the_share_of_the_weight(resample, weight, count):
    """The mean over 4000 draws lies within 4.5 standard errors of count · w: all 36 cases do with 99.9 %."""
    weight, draws = np.array(weight), 4000
    rng = np.random.default_rng(1)
    offspring = np.array([np.bincount(resample(weight, count, rng), minlength=len(weight)) for _ in range(draws)])
    share = weight / weight.sum()
    # No scheme scatters more than independent draws do.
    standard_error = np.sqrt(count * share * (1 - share) / draws)
    assert (np.abs(offspring.mean(axis=0) - count * share) <= 4.5 * standard_error + 1e-12).all()


@schemes
@given(weight=weights, count=st.integers(1, 80), seed=st.integers(0, 100))
def test_indices_are_ascending_and_never_of_a_particle_without_weight(resample, weight, count, seed):
    index = resample(weight, count, np.random.default_rng(seed))
    assert len(index) == count and (np.diff(index) >= 0).all() and (weight[index] > 0).all()


@schemes
@pytest.mark.parametrize("uniform", [0.0, ALMOST_ONE])
@pytest.mark.parametrize("weight", [[0.1] * 10 + [0.0], [0.0, 1 / 3, 1 / 3, 1 / 3, 0.0], [1 / 6] * 6])
def test_a_sum_that_rounding_leaves_beside_one_loses_nobody(resample, weight, uniform):
    """cumsum of ten times 0.1 ends below 1, so a draw next to 1 would fall off the end."""
    weight = np.array(weight)
    index = resample(weight, 30, Draw(uniform))
    assert len(index) == 30 and (weight[index] > 0).all()


@schemes
@pytest.mark.parametrize("weight", [[0.0, 0.0], [np.nan, 1.0], [np.inf, 1.0], [], [-0.5, 1.0]])
def test_weights_that_mean_nothing_are_refused(resample, weight):
    with pytest.raises(ValueError, match="weight"):
        resample(np.array(weight), 3, np.random.default_rng(0))


@given(weight=weights, count=st.integers(1, 80), seed=st.integers(0, 100))
def test_systematic_offspring_are_the_whole_numbers_beside_what_is_expected(weight, count, seed):
    index = systematic_resample(weight, count, np.random.default_rng(seed))
    offspring = np.bincount(index, minlength=len(weight))
    expected = count * weight / weight.sum()
    assert (np.abs(offspring - expected) < 1.0 + 1e-9).all()


@schemes
@pytest.mark.parametrize("seed", range(20))
def test_agrees_with_filterpy(resample, seed, monkeypatch):
    """The same uniform draws give the same indices."""
    oracle = pytest.importorskip("filterpy.monte_carlo")
    weight = np.random.default_rng(seed).exponential(size=50)
    weight /= weight.sum()
    weight[-1] += 1e-9  # filterpy falls off the end of a sum below 1
    drawn = np.random.default_rng([seed, 1])
    monkeypatch.setattr("filterpy.monte_carlo.resampling.random", lambda size=None: drawn.random(size))
    expected = getattr(oracle, resample.__name__)(weight)
    ours = resample(weight, len(weight), np.random.default_rng([seed, 1]))
    np.testing.assert_array_equal(ours, np.sort(expected))


# -- cells -----------------------------------------------------------------------------------------------------------


def test_cells_are_counted_once_and_close_around_the_circle():
    poses = [[0.1, 0.1, 0.1], [0.2, 0.2, 0.15], [-0.1, 0.1, 0.1], [0.1, 0.1, 0.1 + 2 * np.pi], [0.1, 0.1, -0.1]]
    assert cells_of(np.array(poses)).tolist() == [1, 1, 0, 1, 2]


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
    np.testing.assert_array_equal(found.label, place)
    for cluster in range(3):
        own = poses[place == cluster]
        oracle = Particles(POSE, own.T, np.zeros(len(own))).estimate
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
    assert len(found) == 2 and 0.95 <= found.weight.sum() < 1


def test_a_winding_chain_is_one_cluster():
    """A spiral of cells, each touching the next only: labels have to travel along all of it."""
    angle = np.sqrt(np.linspace(1, 3000, 4000))
    spiral = np.stack([0.3 * angle * np.cos(angle), 0.3 * angle * np.sin(angle), np.zeros_like(angle)], axis=-1)
    assert len(find_clusters(spiral, np.ones(len(spiral)), mass=1.0)) == 1


def plain(poses, around):
    """Connected cells by flood fill, one cell after the other."""
    sector = np.floor(poses[:, 2] / CELL_RAD).astype(int) % around
    cells = [(*place, turn) for place, turn in zip(np.floor(poses[:, :2] / CELL_M).astype(int), sector, strict=True)]
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
@given(seed=st.integers(0, 10_000), count=st.integers(1, 40), turns=st.sampled_from([0.2, 0.6, np.pi]))
def test_agrees_with_a_flood_fill(seed, count, turns):
    poses = np.random.default_rng(seed).uniform([-1, -1, np.pi - turns], [1, 1, np.pi + turns], (count, 3))
    label = find_clusters(poses, np.ones(count), mass=1.0).label
    oracle = plain(poses, 36)
    same = [[one == other for other in oracle] for one in oracle]
    np.testing.assert_array_equal(label[:, None] == label[None, :], same)


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 200), mass=st.floats(0.1, 1))
def test_sums_add_up_and_clusters_are_sorted(seed, count, mass):
    rng = np.random.default_rng(seed)
    poses = rng.uniform([-3, -3, -np.pi], [3, 3, np.pi], (count, 3))
    weight = rng.exponential(size=count)
    found = find_clusters(poses, weight, mass=mass)
    assert mass - 1e-9 <= found.weight.sum() <= 1 + 1e-9 and (np.diff(found.weight) <= 0).all()
    np.testing.assert_array_equal(np.unique(found.label[found.label >= 0]), np.arange(len(found)))
    assert (np.linalg.eigvalsh(found.cov) > -1e-12).all()


@pytest.mark.parametrize("weight", [[0.0, 0.0], [np.nan, 1.0], [np.inf, 1.0]])
def test_weights_of_clusters_that_mean_nothing_are_refused(weight):
    with pytest.raises(ValueError, match="weights"):
        find_clusters(np.zeros((2, 3)), np.array(weight))


def test_places_a_world_apart_are_those_of_a_small_box():
    rng = np.random.default_rng(0)
    poses, weight = rng.normal(0, [0.2, 0.2, 0.1], (400, 3)), rng.random(400)
    alone = find_clusters(poses, weight)
    far = find_clusters(np.vstack([poses, [1e5, 1e5, 0.0]]), np.append(weight, 0.0))
    np.testing.assert_array_equal(far.label, [*alone.label, -1])
    np.testing.assert_allclose(far.mean, alone.mean, atol=1e-12)
    np.testing.assert_allclose(far.cov, alone.cov, atol=1e-12)
