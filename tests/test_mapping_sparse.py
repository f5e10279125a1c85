"""Sparse symmetric systems of one pattern, against a dense solver."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csc_array

from localiser.mapping.sparse import Pattern


def definite(size: int, share: float, seed: int) -> csc_array:
    """Return a positive definite matrix (V, V) of which about `share` is filled."""
    rng = np.random.default_rng(seed)
    factor = np.where(rng.random((size, size)) < share, rng.standard_normal((size, size)), 0.0)
    matrix = csc_array(factor @ factor.T + 0.1 * np.eye(size))
    matrix.sort_indices()
    return matrix


@pytest.mark.parametrize("share", [0.0, 0.02, 0.1, 1.0])
@pytest.mark.parametrize("size", [1, 2, 40])
def test_the_solution_is_that_of_a_dense_solver(size: int, share: float) -> None:
    matrix = definite(size, share, seed=size)
    right = np.random.default_rng(1).standard_normal(size)
    pattern = Pattern.of(matrix)
    np.testing.assert_allclose(pattern.solve(matrix.data, right), np.linalg.solve(matrix.toarray(), right), rtol=1e-8)


def test_a_pattern_serves_other_values_at_the_same_places() -> None:
    matrix = definite(60, 0.05, seed=3)
    pattern = Pattern.of(matrix)
    other = matrix.copy()
    other.data *= 0.5
    other.data[pattern.diagonal] += 2.0
    right = np.arange(60.0)
    assert pattern.fits(other)
    np.testing.assert_allclose(pattern.solve(other.data, right), np.linalg.solve(other.toarray(), right), rtol=1e-8)
    assert not pattern.fits(definite(60, 0.05, seed=4))


def test_a_matrix_that_is_not_definite_has_no_solution() -> None:
    matrix = definite(20, 0.1, seed=5)
    pattern = Pattern.of(matrix)
    matrix.data[pattern.diagonal] -= 50.0
    assert np.isnan(pattern.solve(matrix.data, np.ones(20))).all()


def test_what_one_chain_of_neighbours_holds_stays_sparse() -> None:
    size = 500
    chain = csc_array(np.diag(np.full(size, 2.5)) - np.eye(size, k=1) - np.eye(size, k=-1))
    chain.sort_indices()
    assert Pattern.of(chain).column[-1] < 2 * size
