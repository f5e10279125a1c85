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

_AT_ONCE = 512  # columns that are held as a dense matrix at one time
_SUBSTITUTED = 32  # columns that are solved at one time
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
    """R measurements that are linear in V variables.

    jacobian: (R, V) sparse derivatives of the predictions. residual: (R,) measured minus predicted. weight: (R,).
    """

    jacobian: Any
    residual: Array
    weight: Array

    @classmethod
    def of(cls, blocks: list[Block], size: int) -> Linearised:
        """Return the measurements of all blocks, one block after the other, that involve `size` variables."""
        from scipy.sparse import vstack

        return cls(
            vstack([block.jacobian(size) for block in blocks], format="csr"),
            np.concatenate([block.residual for block in blocks]),
            np.concatenate([block.weight for block in blocks]),
        )

    def normal(self) -> tuple[Any, Array]:
        """Return the upper triangle of JᵀWJ (V, V), sparse, and JᵀWr (V,)."""
        from scipy.sparse import triu

        weighted = self.jacobian.copy()
        weighted.data *= np.repeat(self.weight, np.diff(weighted.indptr))
        return triu(weighted.T @ self.jacobian, format="csc"), weighted.T @ self.residual


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
        from localiser.mapping.sparse_kernel import substitute

        lower, diagonal, order = self._solver.factors()
        right, count = columns[order], columns.shape[1]
        result = np.zeros((count // 2, 2, 2))
        for begin in range(0, count, _SUBSTITUTED):
            part = right[:, begin : begin + _SUBSTITUTED].toarray(order="C")
            substitute(lower.indptr, lower.indices, lower.data, part)
            pairs = part.reshape(len(part), -1, 2)
            result[begin // 2 : begin // 2 + pairs.shape[1]] = np.einsum(
                "vpi,vpj->pij", pairs / diagonal[:, None, None], pairs
            )
        return result

    def joint(self, columns: Any) -> Array:
        """Return XᵀA⁻¹X (C, C) of all columns X, sparse (V, C), with each other."""
        result = np.zeros((columns.shape[1], columns.shape[1]))
        for begin in range(0, columns.shape[1], _AT_ONCE):
            dense = columns[:, begin : begin + _AT_ONCE].T.toarray()
            solved = np.array([self.solve(row) for row in dense]).reshape(-1, columns.shape[0])
            result[:, begin : begin + len(solved)] = columns.T @ solved.T
        return result
