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
        pattern = damped.indptr, damped.indices
        if self._pattern is not None and all(map(np.array_equal, self._pattern, pattern)):
            self._solver.update(damped, upper=True)
        else:
            self._solver, self._pattern = qdldl.Solver(damped, upper=True), pattern

    def solve(self, right: Array) -> Array:
        """Return the solution (V,) for a right side (V,)."""
        return np.asarray(self._solver.solve(right))

    def projected(self, columns: Any) -> Array:
        """Return XᵀA⁻¹X (P, 2, 2) of P pairs of columns X, sparse (V, 2 P): YᵀD⁻¹Y with L Y = X."""
        parts = [np.zeros((0, 2, 2))]
        for begin in range(0, columns.shape[1], 2 * _AT_ONCE):
            offset, _, solved = self._substituted(columns[:, begin : begin + 2 * _AT_ONCE])
            products = solved[:, :, None] * solved[:, None, :]
            parts.append(np.add.reduceat(np.concatenate([products, np.zeros((1, 2, 2))]), offset[:-1]))
            parts[-1][np.diff(offset) == 0] = 0.0
        return np.concatenate(parts)

    def joint(self, columns: Any) -> Array:
        """Return XᵀA⁻¹X (C, C) of all columns X, sparse (V, C), C even, with each other."""
        from scipy.sparse import csr_array

        offset, reached, solved = self._substituted(columns)
        column = 2 * np.repeat(np.arange(len(offset) - 1), np.diff(offset))[:, None] + np.arange(2)
        entries = solved.ravel(), (np.repeat(reached, 2), column.ravel())
        half = csr_array(entries, shape=columns.shape)
        return np.asarray((half.T @ half).toarray())

    def _substituted(self, columns: Any) -> tuple[Index, Index, Array]:
        """Return D^-½ Y with L Y = X, of P pairs of columns X, sparse (V, 2 P): the rows of Y (M,), values (M, 2).

        Rows of a pair are those from offset (P + 1,) on. Only what the values of X reach is computed.
        """
        from localiser.mapping.sparse_kernel import count_reached, substitute

        lower, diagonal, order = self._solver.factors()
        place, begin = np.empty(len(order), dtype=np.int64), columns.indptr[::2].astype(np.int64)
        place[order] = np.arange(len(order))
        right = np.zeros((columns.nnz, 2))
        right[np.arange(columns.nnz), np.repeat(np.arange(columns.shape[1]), np.diff(columns.indptr)) % 2] = (
            columns.data
        )
        offset, at = np.zeros(len(begin), dtype=np.int64), place[columns.indices]
        count_reached(lower.indptr, lower.indices, begin, at, np.full(len(order), -1), offset)
        reached, solved = np.empty(offset[-1], dtype=np.int64), np.empty((offset[-1], 2))
        mark, work = np.full(len(order), -1), np.zeros((len(order), 2))
        own = lower.indptr, lower.indices, lower.data
        substitute(*own, begin, at, right, mark, work, offset, reached, solved)
        return offset, reached, solved / np.sqrt(diagonal[reached])[:, None]
