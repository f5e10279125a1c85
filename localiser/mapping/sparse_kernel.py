"""Forward substitution by a sparse triangular matrix for several right sides at once."""

from __future__ import annotations

from localiser.geometry import Array
from localiser.geometry.compiled import compiled
from localiser.mapping.sightings import Index


@compiled
def substitute(begin: Index, row: Index, value: Array, right: Array) -> None:
    """Solve (I + L) Y = R in place.

    begin (V + 1,), row, value: columns of L, strictly below the diagonal. right: R (V, C), then Y. Rows of zeros are
    passed over: what involves few variables reaches only those that are eliminated after them.
    """
    size, count = right.shape
    for column in range(size):
        is_zero = True
        for side in range(count):
            is_zero = is_zero and right[column, side] == 0.0
        if is_zero:
            continue
        for entry in range(begin[column], begin[column + 1]):
            factor, below = value[entry], row[entry]
            for side in range(count):
                right[below, side] -= factor * right[column, side]
