"""Sparse least squares: rows that each involve few variables, one system after another whose pattern stays.

The normal matrix is A = L D Lᵀ, row by row along the elimination tree [Davis, Algorithm 849: LDL, 2005]. Where it has
values, and the tree, are found once; each system after that costs its arithmetic only. Of the inverse only what is
asked for is computed: XᵀA⁻¹X = (L⁻¹X)ᵀ D⁻¹ (L⁻¹X), where L⁻¹X fills along the tree only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.geometry.compiled import checked

Index = NDArray[np.int64]
Index32 = NDArray[np.int32]
_AT_ONCE = 32  # pairs of columns that are solved for side by side


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """R linearised measurements, row after row: row r involves the variables column[start[r]:start[r + 1]].

    start: (R + 1,). column: (E,), negative for what is fixed; each variable at most once in a row. value: (E,)
    derivatives of the prediction. residual, weight: (R,).
    """

    start: Index
    column: Index
    value: Array
    residual: Array
    weight: Array


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Where the normal matrix (V, V) of rows has values when its variables are eliminated in a certain order.

    order: (V,) variables. place: (V,) where each is in it. entry: (E,) the same for each entry of the rows. slot: which
    stored value each product of two entries of a row adds to. start: (V + 1,) where the columns of the upper triangle
    begin, with rows: (U,). diagonal: (V,) where the diagonal is stored. parent: (V,) elimination tree. column: (V + 1,)
    where the columns of L begin.
    """

    order: Index
    place: Index32
    entry: Index32
    slot: Index32
    start: Index32
    rows: Index32
    diagonal: Index32
    parent: Index32
    column: Index32

    @classmethod
    def of(cls, rows: Rows, order: Index) -> Pattern:
        """Return the pattern for rows whose variables are eliminated in the given order (V,)."""
        size = len(order)
        place = np.empty(size, dtype=np.int32)
        place[order] = np.arange(size)
        entry = np.where(rows.column >= 0, place[rows.column], -1).astype(np.int32)
        start, upper, slot, diagonal = checked(pattern_loop)(rows.start, entry, size)
        parent, count = checked(tree_loop)(start, upper)
        column = np.concatenate([[0], np.cumsum(count)]).astype(np.int32)
        return cls(order, place, entry, slot, start, upper, diagonal, parent, column)

    def normal(self, rows: Rows) -> tuple[Array, Array]:
        """Return the stored values (U,) of JᵀWJ, and JᵀW r (V,) in the order of elimination, of rows so patterned."""
        args = (rows.start, self.entry, rows.value, rows.residual, rows.weight, self.slot)
        matrix, right = checked(normal_loop)(*args, len(self.rows), len(self.place))
        return matrix, right

    def factor(self, values: Array) -> Factor:
        """Return the factors of the matrix with these stored values (U,); of nan if it is not positive definite."""
        return Factor(self, *checked(factor_loop)(self.start, self.rows, values, self.parent, self.column))


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """A = L D Lᵀ: below, lower: the rows and values of L under its diagonal, column after column; pivot: (V,) is D."""

    pattern: Pattern
    below: Index32
    lower: Array
    pivot: Array

    def solve(self, right: Array) -> Array:
        """Return the variables (V,) for a right side (V,) in the order of elimination."""
        solution = checked(solve_loop)(self.pattern.column, self.below, self.lower, self.pivot, right)
        return np.asarray(solution[self.pattern.place])

    def taken_up(self, start: Index, variable: Index, value: Array) -> Array:
        """Return XᵀA⁻¹X (P, 2, 2) of P pairs of sparse columns X.

        Pair p has the entries start[p]:start[p + 1]: value (M, 2), its two columns, at variable (M,); negative
        variables are fixed, entries of the same variable add up.
        """
        p = self.pattern
        entry = np.where(variable >= 0, p.place[variable], -1)
        # Pairs that begin at neighbouring variables fill the same part of the tree.
        earliest = np.minimum.reduceat(entry, start[:-1]) if len(start) > 1 else entry[:0]
        order = np.argsort(earliest, kind="stable")
        args = (p.parent, p.column, self.below, self.lower, self.pivot, order, start, entry, value)
        return np.asarray(checked(taken_up_loop)(*args, _AT_ONCE))


# -- plain loops, for numba to compile ---------------------------------------------------------------------------------


def pattern_loop(start: Index, entry: Index32, size: int) -> tuple[Index32, Index32, Index32, Index32]:
    """Return start, rows, slot and diagonal as in `Pattern`, for rows that begin at start and involve entry."""
    row_of, pairs = np.empty(len(entry), np.int32), np.zeros(len(start), np.int64)
    begin = np.zeros(size + 1, np.int64)
    for r in range(len(start) - 1):
        width = start[r + 1] - start[r]
        pairs[r + 1] = pairs[r] + width * (width + 1) // 2
        for e in range(start[r], start[r + 1]):
            row_of[e] = r
            if entry[e] >= 0:
                begin[entry[e] + 1] += 1
    begin = np.cumsum(begin)
    involved, filled = np.empty(begin[size], np.int32), begin[:-1].copy()
    for e in range(len(entry)):
        if entry[e] >= 0:
            involved[filled[entry[e]]] = e
            filled[entry[e]] += 1
    slot, above = np.full(pairs[-1], -1, np.int32), np.empty(pairs[-1], np.int32)
    columns, diagonal = np.zeros(size + 1, np.int32), np.empty(size, np.int32)
    stored, stored_at, count = np.full(size, -1, np.int32), np.empty(size, np.int32), 0
    for k in range(size):
        stored[k], stored_at[k], above[count], diagonal[k] = k, count, k, count
        count += 1
        for e in involved[begin[k] : begin[k + 1]]:
            r = row_of[e]
            for f in range(start[r], start[r + 1]):
                i = entry[f]
                if i < 0 or i > k:
                    continue
                if stored[i] != k:
                    stored[i], stored_at[i], above[count] = k, count, i
                    count += 1
                high, low = max(e, f) - start[r], min(e, f) - start[r]
                slot[pairs[r] + high * (high + 1) // 2 + low] = stored_at[i]
        columns[k + 1] = count
    return columns, above[:count].copy(), slot, diagonal


def normal_loop(
    start: Index,
    entry: Index32,
    value: Array,
    residual: Array,
    weight: Array,
    slot: Index32,
    stored: int,
    size: int,
) -> tuple[Array, Array]:
    """Return the stored values of JᵀWJ, and JᵀW r, of the rows; see `Pattern`."""
    matrix, right = np.zeros(stored), np.zeros(size)
    pair = 0
    for r in range(len(start) - 1):
        for e in range(start[r], start[r + 1]):
            weighted = weight[r] * value[e]
            if entry[e] >= 0:
                right[entry[e]] += weighted * residual[r]
            for f in range(start[r], e + 1):
                if slot[pair] >= 0:
                    matrix[slot[pair]] += weighted * value[f]
                pair += 1
    return matrix, right


def tree_loop(start: Index32, rows: Index32) -> tuple[Index32, Index32]:
    """Return the elimination tree (V,), -1 for a root, and how many values each column of L has below its diagonal."""
    size = len(start) - 1
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


def factor_loop(
    start: Index32, rows: Index32, values: Array, parent: Index32, column: Index32
) -> tuple[Index32, Array, Array]:
    """Return below, lower and pivot as in `Factor`; see `Pattern`."""
    size = len(parent)
    below, lower, pivot = np.empty(column[size], np.int32), np.empty(column[size]), np.empty(size)
    filled, flag, path = column.copy(), np.full(size, -1, np.int32), np.empty(size, np.int32)
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
        diagonal, row[k] = row[k], 0.0
        for t in range(top, size):
            i = path[t]
            value = row[i]
            row[i] = 0.0
            for p in range(column[i], filled[i]):
                row[below[p]] -= lower[p] * value
            scaled = value / pivot[i]
            diagonal -= scaled * value
            below[filled[i]], lower[filled[i]] = k, scaled
            filled[i] += 1
        if not diagonal > 0.0:
            pivot[:] = np.nan
            break
        pivot[k] = diagonal
    return below, lower, pivot


def solve_loop(column: Index32, below: Index32, lower: Array, pivot: Array, right: Array) -> Array:
    """Return the solution (V,) of L D Lᵀ x = right."""
    solution = right.copy()
    for j in range(len(pivot)):
        for p in range(column[j], column[j + 1]):
            solution[below[p]] -= lower[p] * solution[j]
    solution /= pivot
    for j in range(len(pivot) - 1, -1, -1):
        for p in range(column[j], column[j + 1]):
            solution[j] -= lower[p] * solution[below[p]]
    return solution


def taken_up_loop(
    parent: Index32,
    column: Index32,
    below: Index32,
    lower: Array,
    pivot: Array,
    order: Index,
    start: Index,
    entry: Index,
    value: Array,
    at_once: int,
) -> Array:
    """Return what `Factor.taken_up` does, `at_once` pairs at a time in the given order, along the tree only."""
    size, pairs = len(parent), len(start) - 1
    taken, reached = np.zeros((pairs, 2, 2)), np.zeros(size, np.bool_)
    work = np.zeros((size, 2 * at_once))
    for begin in range(0, pairs, at_once):
        many = min(at_once, pairs - begin)
        for v in range(many):
            pair = order[begin + v]
            for e in range(start[pair], start[pair + 1]):
                i = entry[e]
                if i >= 0:
                    work[i, 2 * v] += value[e, 0]
                    work[i, 2 * v + 1] += value[e, 1]
                while i >= 0 and not reached[i]:
                    reached[i] = True
                    i = parent[i]
        for j in range(size):
            if not reached[j]:
                continue
            own = work[j]
            for p in range(column[j], column[j + 1]):
                other = work[below[p]]
                for c in range(2 * many):
                    other[c] -= lower[p] * own[c]
            for v in range(many):
                pair, x, y = order[begin + v], own[2 * v], own[2 * v + 1]
                taken[pair, 0, 0] += x * x / pivot[j]
                taken[pair, 0, 1] += x * y / pivot[j]
                taken[pair, 1, 1] += y * y / pivot[j]
            own[:] = 0.0
            reached[j] = False
    taken[:, 1, 0] = taken[:, 0, 1]
    return taken
