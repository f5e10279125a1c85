"""Sparse linear least squares: the normal equations of linearised measurements, and their covariances.

Each measurement involves few variables, so that the normal matrix A = JᵀWJ has few values. QDLDL factors it as L D Lᵀ,
in an order of elimination by approximate minimum degree that keeps L sparse [Davis, Algorithm 849: LDL, 2005; Amestoy,
Davis, Duff 1996]. Order and structure of L are found once for all matrices of one pattern. Of the inverse only what is
asked for is computed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.geometry.compiled import compiled

Index = NDArray[np.int64]

TOGETHER = 16
"""Columns of a right side that are substituted at one time."""
_AT_ONCE = 512  # pairs of columns that are solved at one time
_REGULAR = 1e-9  # added to the diagonal: no variable is wholly unknown


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """K measurements of one kind, each of C variables: column, value (K, C), residual, weight (K,); see `Linearised`.

    column: negative for what is fixed.
    """

    column: Index
    value: Array
    residual: Array
    weight: Array

    def jacobian(self, size: int) -> Any:
        """Return the derivatives (K, V), sparse, by all V variables; those that are 0 are left out."""
        from scipy.sparse import csr_array

        free = (self.column >= 0) & (self.value != 0)
        begin = np.concatenate([[0], np.cumsum(free.sum(axis=1))])
        return csr_array((self.value[free], self.column[free], begin), shape=(len(self.residual), size))


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Blocks of R measurements in all, one after the other, that are linear in V variables."""

    blocks: list[Block]
    size: int

    @property
    def residual(self) -> Array:
        """Measured minus predicted (R,)."""
        return np.concatenate([block.residual for block in self.blocks])

    @property
    def weight(self) -> Array:
        """The weights (R,)."""
        return np.concatenate([block.weight for block in self.blocks])

    @property
    def jacobian(self) -> Any:
        """The derivatives of the predictions (R, V), sparse."""
        from scipy.sparse import vstack

        return vstack([block.jacobian(self.size) for block in self.blocks], format="csr")

    def normal(self) -> tuple[Any, Array]:
        """Return the upper triangle of JᵀWJ (V, V), sparse, and JᵀWr (V,)."""
        from scipy.sparse import diags_array, triu

        jacobian = self.jacobian
        transposed = (diags_array(self.weight) @ jacobian).T
        return triu(transposed @ jacobian, format="csc"), transposed @ self.residual


class Factor:
    """A symmetric positive definite matrix (V, V) in factors."""

    def __init__(self) -> None:
        self._solver: Any = None
        self._parts: tuple[Any, Array, Index] | None = None
        self._pattern: tuple[Index, Index] | None = None

    def update(self, upper: Any, damping: float = 0.0) -> None:
        """Factor the matrix with this sparse upper triangle (V, V), its diagonal enlarged by `damping` times itself."""
        import qdldl
        from scipy.sparse import csc_matrix

        damped = csc_matrix(upper, copy=True)
        damped.sum_duplicates()
        # In sorted columns of an upper triangle the diagonal comes last.
        diagonal = damped.indptr[1:] - 1
        damped.data[diagonal] += damping * damped.data[diagonal] + _REGULAR
        pattern, self._parts = (damped.indptr, damped.indices), None
        if self._pattern is not None and all(map(np.array_equal, self._pattern, pattern)):
            self._solver.update(damped, upper=True)
        else:
            self._solver, self._pattern = qdldl.Solver(damped, upper=True), pattern

    def solve(self, right: Array) -> Array:
        """Return the solution (V,) for a right side (V,)."""
        return np.asarray(self._solver.solve(right))

    def projected(self, columns: Any) -> Array:
        """Return XᵀA⁻¹X (P, 2, 2) of P pairs of columns X, sparse (V, 2 P): YᵀD⁻¹Y with L Y = X."""
        order, result = self._by_place(columns), np.zeros((columns.shape[1] // 2, 2, 2))
        for begin in range(0, len(order), _AT_ONCE):
            part = order[begin : begin + _AT_ONCE]
            offset, _, solved = self._substituted(columns, part)
            pairs = solved.reshape(len(solved), TOGETHER // 2, 2)
            for group, first in enumerate(range(0, len(part), TOGETHER // 2)):
                own, of_group = pairs[offset[group] : offset[group + 1]], part[first : first + TOGETHER // 2]
                result[of_group] = np.einsum("mpi,mpj->pij", own, own)[: len(of_group)]
        return result

    def joint(self, columns: Any) -> Array:
        """Return XᵀA⁻¹X (C, C) of all columns X, sparse (V, C), C even, with each other."""
        order = self._by_place(columns)
        offset, reached, solved = self._substituted(columns, order)
        row, place = np.unique(reached, return_inverse=True)
        half = np.zeros((len(row), len(offset) - 1, TOGETHER))
        half[place, np.repeat(np.arange(len(offset) - 1), np.diff(offset))] = solved
        half = half.reshape(len(row), TOGETHER * (len(offset) - 1))[:, : columns.shape[1]]
        back = np.empty(columns.shape[1], dtype=np.int64)
        back[(2 * order[:, None] + np.arange(2)).ravel()] = np.arange(columns.shape[1])
        return np.asarray((half.T @ half)[np.ix_(back, back)])

    def _by_place(self, columns: Any) -> Index:
        """Return the pairs (P,) of columns, sparse (V, 2 P), as the first variable of each is eliminated."""
        place = self._factors()[2][columns.indices]
        begin = columns.indptr[:-1:2]
        first = np.minimum.reduceat(np.append(place, len(place)), begin) if len(begin) else begin
        return np.argsort(first, kind="stable")

    def _factors(self) -> tuple[Any, Array, Index]:
        """Return L, D, and for each variable (V,) when it is eliminated. The solver copies L whenever it is asked."""
        if self._parts is None:
            lower, diagonal, order = self._solver.factors()
            place = np.empty(len(order), dtype=np.int64)
            place[order] = np.arange(len(order))
            self._parts = lower, diagonal, place
        return self._parts

    def _substituted(self, columns: Any, pairs: Index) -> tuple[Index, Index, Array]:
        """Return D^-½ Y with L Y = X, of the pairs (P,) of columns X, sparse (V, ·), by groups of `TOGETHER` columns.

        Rows of a group are those from offset (G + 1,) on: reached (M,), and their values (M, TOGETHER). Only what the
        values of X reach is computed.
        """
        lower, diagonal, places = self._factors()
        own = columns[:, (2 * pairs[:, None] + np.arange(2)).ravel()]
        ends = np.append(np.arange(0, own.shape[1], TOGETHER), own.shape[1])
        begin, at = own.indptr[ends].astype(np.int64), places[own.indices]
        column = np.repeat(np.arange(own.shape[1]), np.diff(own.indptr)) % TOGETHER
        offset, size = np.zeros(len(begin), dtype=np.int64), len(diagonal)
        compiled(count_reached)(lower.indptr, lower.indices, begin, at, np.full(size, -1), offset)
        reached, solved = np.empty(offset[-1], dtype=np.int64), np.empty((offset[-1], TOGETHER))
        mark, work = np.full(size, -1), np.zeros((size, TOGETHER))
        of_lower = lower.indptr, lower.indices, lower.data
        compiled(substitute)(*of_lower, begin, at, column, own.data, mark, work, offset, reached, solved)
        return offset, reached, solved / np.sqrt(diagonal[reached])[:, None]


# -- loops for numba to compile, when they are called ------------------------------------------------------------------


def count_reached(begin: Index, row: Index, right_begin: Index, right_row: Index, mark: Index, offset: Index) -> None:
    """Count the rows in which Y of (I + L) Y = R has values, for each group of columns of R: into `offset` (G + 1,).

    A value at row j reaches the rows of column j of L: they all lie on the way from j to the root of the elimination
    tree, in which the parent of j is the first row of its column. See `substitute`; mark: (V,) of -1.
    """
    for group in range(len(right_begin) - 1):
        count = 0
        for entry in range(right_begin[group], right_begin[group + 1]):
            node = right_row[entry]
            while node >= 0 and mark[node] != group:
                mark[node] = group
                count += 1
                node = row[begin[node]] if begin[node] < begin[node + 1] else -1
        offset[group + 1] = offset[group] + count


def substitute(
    begin: Index,
    row: Index,
    value: Array,
    right_begin: Index,
    right_row: Index,
    right_column: Index,
    right_value: Array,
    mark: Index,
    work: Array,
    offset: Index,
    reached: Index,
    solved: Array,
) -> None:
    """Solve (I + L) Y = R for G groups of `TOGETHER` columns, into rows `reached` (M,), values `solved` (M, TOGETHER).

    begin (V + 1,), row, value: columns of L, strictly below the diagonal, rows in order. right_begin (G + 1,),
    right_row, right_column (in the group), right_value: the values of R. offset (G + 1,): where the rows of each group
    begin, see `count_reached`. mark (V,) of -1 and work (V, TOGETHER) of 0 are scratch, of which mark is left changed.
    Columns of a group share what is read of L, so they should reach nearly the same rows.
    """
    own = np.empty(TOGETHER)
    for group in range(len(right_begin) - 1):
        first = offset[group + 1]
        for entry in range(right_begin[group], right_begin[group + 1]):
            node, length = right_row[entry], 0
            work[node, right_column[entry]] += right_value[entry]
            while node >= 0 and mark[node] != group:
                mark[node] = group
                length += 1
                node = row[begin[node]] if begin[node] < begin[node + 1] else -1
            # No row found before comes before these in the tree, so these go in front.
            first -= length
            node = right_row[entry]
            for step in range(length):
                reached[first + step] = node
                node = row[begin[node]] if begin[node] < begin[node + 1] else -1
        for index in range(offset[group], offset[group + 1]):
            node = reached[index]
            for column in range(TOGETHER):
                own[column] = work[node, column]
                solved[index, column] = own[column]
                work[node, column] = 0.0
            for entry in range(begin[node], begin[node + 1]):
                below, factor = row[entry], value[entry]
                for column in range(TOGETHER):
                    work[below, column] -= factor * own[column]
