"""Solve one sparse symmetric positive definite system after another whose pattern stays.

A = L D Lᵀ, row by row along the elimination tree [Davis, Algorithm 849: LDL, 2005]. The order of the variables that
keeps L sparse, and the tree, are found once; each system after that costs its arithmetic only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array

Index32 = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Where a symmetric matrix (V, V) has values, and in which order its variables are eliminated.

    order: (V,) variables. source: (U,) which of the matrix's stored values make up the upper triangle of the reordered
    one, whose columns begin at start: (V + 1,) with rows: (U,). parent: (V,) elimination tree. column: (V + 1,) where
    the columns of L begin. diagonal: (V,) which stored values are on the diagonal.
    """

    order: Index32
    source: Index32
    start: Index32
    rows: Index32
    parent: Index32
    column: Index32
    diagonal: Index32
    stored: tuple[Index32, Index32]

    @classmethod
    def of(cls, matrix: Any) -> Pattern:
        """Return the pattern of a sparse symmetric matrix (V, V) in sorted column form, by minimum degree."""
        from scipy.sparse import csc_array
        from scipy.sparse.linalg import splu

        size = matrix.shape[0]
        own = np.repeat(np.arange(size), np.diff(matrix.indptr))
        diagonal = np.flatnonzero(matrix.indices == own).astype(np.int32)
        # The order depends on the pattern alone; with these values any can be eliminated.
        easy = csc_array(
            (np.where(matrix.indices == own, size, 0.5), matrix.indices, matrix.indptr), shape=matrix.shape
        )
        factor = splu(easy, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        order = np.argsort(factor.perm_c).astype(np.int32)
        # The values are the numbers of the stored values, so that the upper triangle says where it came from.
        numbered = csc_array((np.arange(1, matrix.nnz + 1), matrix.indices, matrix.indptr), shape=matrix.shape)
        moved = numbered[order][:, order].tocsc()
        moved.sort_indices()
        column = np.repeat(np.arange(size), np.diff(moved.indptr))
        upper = moved.indices <= column
        start = np.concatenate([[0], np.cumsum(np.bincount(column[upper], minlength=size))]).astype(np.int32)
        rows = moved.indices[upper].astype(np.int32)
        parent, count = _compiled(tree_loop)(size, start, rows)
        begin = np.concatenate([[0], np.cumsum(count)]).astype(np.int32)
        source = (moved.data[upper] - 1).astype(np.int32)
        return cls(order, source, start, rows, parent, begin, diagonal, (matrix.indptr, matrix.indices))

    def fits(self, matrix: Any) -> bool:
        """Return whether a sparse matrix in sorted column form has this pattern."""
        pointers, indices = self.stored
        return np.array_equal(pointers, matrix.indptr) and np.array_equal(indices, matrix.indices)

    def solve(self, values: Array, right: Array) -> Array:
        """Return the solution (V,) for a matrix of this pattern with stored `values`; nan if it is not definite."""
        solved = _compiled(solve_loop)(
            self.start, self.rows, values[self.source], self.parent, self.column, right[self.order]
        )
        result = np.empty_like(right)
        result[self.order] = solved
        return result


def tree_loop(size: int, start: Index32, rows: Index32) -> tuple[Index32, Index32]:
    """Return the elimination tree (V,), -1 for a root, and how many values each column of L has below its diagonal."""
    parent, flag, count = np.full(size, -1, np.int32), np.full(size, -1, np.int32), np.zeros(size, np.int32)
    for k in range(size):
        flag[k] = k
        for p in range(start[k], start[k + 1]):
            i = rows[p]
            while flag[i] != k:
                if parent[i] == -1:
                    parent[i] = k
                count[i] += 1
                flag[i] = k
                i = parent[i]
    return parent, count


def solve_loop(start: Index32, rows: Index32, values: Array, parent: Index32, column: Index32, right: Array) -> Array:
    """Return the solution (V,) of one system, as in `Pattern`; factorisation and both substitutions."""
    size = len(parent)
    below, lower, pivot = np.empty(column[size], np.int32), np.empty(column[size]), np.empty(size)
    filled, flag, path = np.zeros(size, np.int32), np.full(size, -1, np.int32), np.empty(size, np.int32)
    row = np.zeros(size)
    for k in range(size):
        flag[k] = k
        top = size
        for p in range(start[k], start[k + 1]):
            i = rows[p]
            row[i] += values[p]
            length = 0
            while flag[i] != k:
                path[length] = i
                length += 1
                flag[i] = k
                i = parent[i]
            while length > 0:
                top -= 1
                length -= 1
                path[top] = path[length]
        pivot[k] = row[k]
        row[k] = 0.0
        for t in range(top, size):
            i = path[t]
            value = row[i]
            row[i] = 0.0
            end = column[i] + filled[i]
            for p in range(column[i], end):
                row[below[p]] -= lower[p] * value
            scaled = value / pivot[i]
            pivot[k] -= scaled * value
            below[end], lower[end] = k, scaled
            filled[i] += 1
        if not pivot[k] > 0.0:
            return np.full(size, np.nan)
    solution = right.copy()
    for j in range(size):
        for p in range(column[j], column[j + 1]):
            solution[below[p]] -= lower[p] * solution[j]
    solution /= pivot
    for j in range(size - 1, -1, -1):
        for p in range(column[j], column[j + 1]):
            solution[j] -= lower[p] * solution[below[p]]
    return solution


@cache
def _compiled(loop: Callable[..., Any]) -> Callable[..., Any]:
    """Return a loop as machine code; kept on disk, so that only the first run ever waits for it."""
    import numba

    return numba.njit(cache=True)(loop)
