"""Sparse least squares against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csc_array

from localiser.geometry import Array
from localiser.mapping.sparse import Block, Factor, Linearised


def some_blocks(size: int, count: int, most: int, seed: int) -> list[Block]:
    """Return measurements of `most` variables each, some of them fixed, that tell something of every variable."""
    rng = np.random.default_rng(seed)
    column = np.array([rng.permutation(np.arange(-1, size))[:most] for _ in range(count)], dtype=np.int64)
    several = Block(
        column.reshape(count, most),
        rng.standard_normal((count, most)),
        rng.standard_normal(count),
        rng.uniform(0.1, 1.0, count),
    )
    single = Block(np.arange(size)[:, None], rng.uniform(0.5, 2.0, (size, 1)), rng.standard_normal(size), np.ones(size))
    return [several, single]


def dense(blocks: list[Block], size: int) -> tuple[Array, Array]:
    """Return JᵀWJ (V, V) and JᵀWr (V,)."""
    rows = []
    for block in blocks:
        jacobian = np.zeros((len(block.residual), size + 1))
        jacobian[np.arange(len(jacobian))[:, None], block.column] = block.value  # what is fixed goes to the last column
        rows.append((jacobian[:, :size], block.residual, block.weight))
    jacobian, residual, weight = (np.concatenate(part) for part in zip(*rows, strict=True))
    return jacobian.T @ (weight[:, None] * jacobian), jacobian.T @ (weight * residual)


@pytest.mark.parametrize(("size", "count", "most"), [(1, 0, 1), (2, 3, 2), (40, 0, 1), (40, 30, 3), (40, 60, 40)])
def test_the_solution_is_that_of_dense_algebra(size: int, count: int, most: int) -> None:
    blocks, factor = some_blocks(size, count, most, seed=size), Factor()
    upper, right = Linearised(blocks, size).normal()
    matrix, gradient = dense(blocks, size)
    np.testing.assert_allclose(upper.toarray(), np.triu(matrix), atol=1e-12)
    np.testing.assert_allclose(right, gradient, atol=1e-12)
    factor.update(upper)
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(matrix, gradient), rtol=1e-6)
    factor.update(upper, damping=0.5)
    damped = matrix + 0.5 * np.diag(np.diagonal(matrix))
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(damped, gradient), rtol=1e-6)


@pytest.mark.parametrize("count", [50, 20])
def test_a_factor_serves_other_matrices_whether_or_not_values_are_at_the_same_places(count: int) -> None:
    first, other, factor = some_blocks(60, 50, 4, seed=3), some_blocks(60, count, 4, seed=3 + (count < 50)), Factor()
    other[0].value[:] = 2 * other[0].value + 0.1
    factor.update(Linearised(first, 60).normal()[0])
    upper, right = Linearised(other, 60).normal()
    factor.update(upper)
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(*dense(other, 60)), rtol=1e-6)


@pytest.mark.parametrize("pairs", [0, 1, 600])
def test_the_inverse_between_sparse_columns_is_that_of_dense_algebra(pairs: int) -> None:
    blocks, rng, factor = some_blocks(50, 40, 4, seed=7), np.random.default_rng(8), Factor()
    columns = np.where(rng.random((50, 2 * pairs)) < 0.1, rng.standard_normal((50, 2 * pairs)), 0.0)
    factor.update(Linearised(blocks, 50).normal()[0])
    of_pair = columns.T.reshape(pairs, 2, 50)
    expected = of_pair @ np.linalg.inv(dense(blocks, 50)[0]) @ of_pair.transpose(0, 2, 1)
    np.testing.assert_allclose(factor.projected(csc_array(columns)), expected, rtol=1e-6, atol=1e-9)
    whole = columns.T @ np.linalg.inv(dense(blocks, 50)[0]) @ columns
    np.testing.assert_allclose(factor.joint(csc_array(columns)), whole, rtol=1e-6, atol=1e-9)
