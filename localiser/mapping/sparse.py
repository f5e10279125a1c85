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

Index = NDArray[np.int64]

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
        """Return the derivatives (K, V), sparse, by all V variables."""
        from scipy.sparse import csr_array

        free = self.column >= 0
        entries = self.value[free], (np.nonzero(free)[0], self.column[free])
        return csr_array(entries, shape=(len(self.residual), size))


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

    def normal(self, pattern: Pattern | None = None) -> tuple[Any, Array]:
        """Return the upper triangle of JᵀWJ (V, V), sparse, and JᵀWr (V,). pattern: `Pattern.of` the same columns."""
        from scipy.sparse import csc_array

        from localiser.mapping.sparse_kernel import add_products

        pattern = pattern or Pattern.of(self)
        value, gradient = np.zeros(len(pattern.row)), np.zeros(self.size)
        for block, place in zip(self.blocks, pattern.place, strict=True):
            add_products(block.column, block.value, block.residual, block.weight, place, value, gradient)
        return csc_array((value, pattern.row, pattern.begin), shape=(self.size, self.size)), gradient


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Where an upper triangle JᵀWJ has values: the rows of its columns, which begin at `begin` (V + 1,).

    place: for each block, where the product of each two variables of a measurement goes, (K, C (C + 1) / 2), -1 where
    one of them has no influence. known: for each block, which derivatives (K, C) may be other than 0.
    """

    begin: NDArray[np.int32]
    row: NDArray[np.int32]
    place: list[NDArray[np.int32]]
    known: list[NDArray[np.bool_]]

    def holds(self, linear: Linearised) -> bool:
        """Return whether these measurements have no value where the pattern has none."""
        return not any((block.value != 0)[~known].any() for block, known in zip(linear.blocks, self.known, strict=True))

    @classmethod
    def of(cls, linear: Linearised) -> Pattern:
        """Return the pattern that the columns of measurements make."""
        from scipy.sparse import triu

        from localiser.mapping.sparse_kernel import find_places

        ones = linear.jacobian
        ones.data[:] = ones.data != 0
        upper = triu(ones.T @ ones, format="csc")
        upper.eliminate_zeros()
        upper.sort_indices()
        begin, row, place = upper.indptr.astype(np.int32), upper.indices.astype(np.int32), []
        for block in linear.blocks:
            count = block.column.shape[1]
            place.append(np.full((len(block.column), count * (count + 1) // 2), -1, dtype=np.int32))
            find_places(block.column, begin, row, place[-1])
        return cls(begin, row, place, [block.value != 0 for block in linear.blocks])


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
        from localiser.mapping.sparse_kernel import TOGETHER

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
        from localiser.mapping.sparse_kernel import TOGETHER

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
        from localiser.mapping.sparse_kernel import TOGETHER, count_reached, substitute

        lower, diagonal, places = self._factors()
        own = columns[:, (2 * pairs[:, None] + np.arange(2)).ravel()]
        ends = np.append(np.arange(0, own.shape[1], TOGETHER), own.shape[1])
        begin, at = own.indptr[ends].astype(np.int64), places[own.indices]
        column = np.repeat(np.arange(own.shape[1]), np.diff(own.indptr)) % TOGETHER
        offset, size = np.zeros(len(begin), dtype=np.int64), len(diagonal)
        count_reached(lower.indptr, lower.indices, begin, at, np.full(size, -1), offset)
        reached, solved = np.empty(offset[-1], dtype=np.int64), np.empty((offset[-1], TOGETHER))
        mark, work = np.full(size, -1), np.zeros((size, TOGETHER))
        of_lower = lower.indptr, lower.indices, lower.data
        substitute(*of_lower, begin, at, column, own.data, mark, work, offset, reached, solved)
        return offset, reached, solved / np.sqrt(diagonal[reached])[:, None]
