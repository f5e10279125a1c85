"""Resampling: as many offspring as the weights say, against filterpy and against statistics; KLD against Fox."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from localiser.particles import clusters, resampling

SCHEMES = [
    resampling.systematic_resample,
    resampling.multinomial_resample,
]
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
    assert len(index) == count
    assert (np.diff(index) >= 0).all()
    assert (weight[index] > 0).all()


@schemes
@pytest.mark.parametrize("uniform", [0.0, ALMOST_ONE])
@pytest.mark.parametrize("weight", [[0.1] * 10 + [0.0], [0.0, 1 / 3, 1 / 3, 1 / 3, 0.0], [1 / 6] * 6])
def test_a_sum_that_rounding_leaves_beside_one_loses_nobody(resample, weight, uniform):
    """cumsum of ten times 0.1 ends below 1, so a draw next to 1 would fall off the end."""
    weight = np.array(weight)
    index = resample(weight, 30, Draw(uniform))
    assert len(index) == 30
    assert (weight[index] > 0).all()


@schemes
@pytest.mark.parametrize("weight", [[0.0, 0.0], [np.nan, 1.0], [np.inf, 1.0], [], [-0.5, 1.0]])
def test_weights_that_mean_nothing_are_refused(resample, weight):
    with pytest.raises(ValueError, match="weight"):
        resample(np.array(weight), 3, np.random.default_rng(0))


@given(weight=weights, count=st.integers(1, 80), seed=st.integers(0, 100))
def test_systematic_offspring_are_the_whole_numbers_beside_what_is_expected(weight, count, seed):
    index = resampling.systematic_resample(weight, count, np.random.default_rng(seed))
    offspring = np.bincount(index, minlength=len(weight))
    expected = count * weight / weight.sum()
    assert (offspring >= np.floor(expected - 1e-9)).all()
    assert (offspring <= np.ceil(expected + 1e-9)).all()


@pytest.mark.parametrize("name", ["systematic_resample", "multinomial_resample"])
@pytest.mark.parametrize("seed", range(20))
def test_agrees_with_filterpy(name, seed, monkeypatch):
    """The same uniform draws give the same indices."""
    oracle = pytest.importorskip("filterpy.monte_carlo")
    weight = np.random.default_rng(seed).exponential(size=50)
    weight /= weight.sum()
    weight[-1] += 1e-9  # filterpy falls off the end of a sum below 1
    drawn = np.random.default_rng([seed, 1])
    monkeypatch.setattr("filterpy.monte_carlo.resampling.random", lambda size=None: drawn.random(size))
    expected = getattr(oracle, name)(weight)
    ours = getattr(resampling, name)(weight, len(weight), np.random.default_rng([seed, 1]))
    np.testing.assert_array_equal(ours, np.sort(expected))


# -- cells -----------------------------------------------------------------------------------------------------------


def test_cells_are_counted_once_and_close_around_the_circle():
    quarter = np.pi / 2
    poses = np.array(
        [[0.1, 0.1, 0.1], [0.2, 0.9, 0.2], [-0.1, 0.1, 0.1], [0.1, 0.1, 0.1 + 2 * np.pi], [0.1, 0.1, -0.1]]
    )
    assert clusters.cells_of(poses, 1.0, quarter).max() + 1 == 3
    assert clusters.cells_of(poses, 1.0, 2 * np.pi).max() + 1 == 2
    assert clusters.cells_of(poses, 0.5, quarter).max() + 1 == 4


@pytest.mark.parametrize("cell", [(0.0, 0.1), (0.1, 0.0), (-1.0, 0.1)])
def test_cells_without_extent_are_refused(cell):
    with pytest.raises(ValueError, match="cells"):
        clusters.cells_of(np.zeros((1, 3)), *cell)
