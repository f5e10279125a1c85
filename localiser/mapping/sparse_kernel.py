"""Sums of products into a sparse matrix, and forward substitution by a triangular one for right sides of few values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.geometry.compiled import compiled
from localiser.mapping.sightings import Index

Index32 = NDArray[np.int32]

TOGETHER = 16
"""Columns of a right side that are substituted at one time."""


@compiled
def find_places(column: Index, begin: Index32, row: Index32, place: Index32) -> None:
    """Write where products of two variables of measurements stand in an upper triangle, (K, C (C + 1) / 2), if they do.

    column: (K, C) variables, negative for none. begin (V + 1,), row: of the triangle's columns, rows in order.
    """
    for k in range(len(column)):
        at = 0
        for i in range(column.shape[1]):
            for j in range(i + 1):
                above, right = min(column[k, i], column[k, j]), max(column[k, i], column[k, j])
                if above >= 0:
                    low, high = begin[right], begin[right + 1] - 1
                    while low < high:
                        middle = (low + high) // 2
                        if row[middle] < above:
                            low = middle + 1
                        else:
                            high = middle
                    if low <= high and row[low] == above:
                        place[k, at] = low
                at += 1


@compiled
def add_products(
    column: Index, derivative: Array, residual: Array, weight: Array, place: Index32, value: Array, gradient: Array
) -> None:
    """Add w j jᵀ to the values of a matrix at the places that `find_places` found, and w j r to the gradient (V,).

    column, derivative j: (K, C), residual r, weight w: (K,) of the measurements.
    """
    for k in range(len(column)):
        at = 0
        for i in range(column.shape[1]):
            if column[k, i] >= 0:
                gradient[column[k, i]] += weight[k] * derivative[k, i] * residual[k]
            for j in range(i + 1):
                if place[k, at] >= 0:
                    above, right = (i, j) if column[k, i] < column[k, j] else (j, i)
                    value[place[k, at]] += weight[k] * derivative[k, above] * derivative[k, right]
                at += 1


@compiled
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


@compiled
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
    begin, see `count_reached`. mark (V,) of -1, work (V, TOGETHER) of 0: as they are lent they are not given back.
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
