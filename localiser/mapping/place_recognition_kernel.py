"""The inner loops of `place_recognition`, for numba to compile when they are called."""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array
from localiser.mapping.sightings import Index


def explained_loop(
    new: Array, old: Array, row: Index, column: Index, moves: Array, close_m: float
) -> tuple[Index, Index]:
    """Return how many of the group (A, 2) each move (M, 3) brings onto older ones (B, 2), and the last one's match.

    row, column: (P,) pairs that may be one. Two match that are each other's nearest and nearer than `close_m`. match:
    (A,) the older landmark of each, -1 for none. Plain loops, for numba to compile.
    """
    count = np.zeros(len(moves), dtype=np.int64)
    match, back = np.empty(len(new), dtype=np.int64), np.empty(len(old), dtype=np.int64)
    nearest, nearest_back = np.empty(len(new)), np.empty(len(old))
    for m in range(len(moves)):
        cos, sin = np.cos(moves[m, 2]), np.sin(moves[m, 2])
        match[:], back[:] = -1, -1
        nearest[:], nearest_back[:] = close_m**2, close_m**2
        for k in range(len(row)):
            a, b = row[k], column[k]
            x = cos * new[a, 0] - sin * new[a, 1] + moves[m, 0] - old[b, 0]
            z = sin * new[a, 0] + cos * new[a, 1] + moves[m, 1] - old[b, 1]
            apart = x * x + z * z
            if apart < nearest[a]:
                nearest[a], match[a] = apart, b
            if apart < nearest_back[b]:
                nearest_back[b], back[b] = apart, a
        for a in range(len(new)):
            if match[a] >= 0 and back[match[a]] == a:
                count[m] += 1
            else:
                match[a] = -1
    return count, match


def alike_pairs_loop(
    new: Array, old: Array, row: Index, baseline_m: float, close_m: float, most: int
) -> tuple[Index, Index]:
    """Return two of the matches (P,) each (M,) whose landmarks are as far apart in the group as among the older ones.

    new: (A, 2) places of the group, row: (P,) which of them a match has, old: (P, 2) where its older one stands. Nearer
    than `baseline_m` they tell no turn. Of more than `most`, every second, third … one. Plain loops for numba.
    """
    length = np.sqrt((new[:, :1] - new[:, 0]) ** 2 + (new[:, 1:] - new[:, 1]) ** 2)
    # Squares of the distances that count as the same; none does where the baseline is too short.
    least, largest = np.maximum(length - close_m, 0.0) ** 2, np.where(length > baseline_m, (length + close_m) ** 2, 0.0)
    one, other = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    every, met, kept = 1, 0, 0
    for i in range(len(row)):
        low, high = least[row[i]], largest[row[i]]
        for j in range(i + 1, len(row)):
            apart = (old[j, 0] - old[i, 0]) ** 2 + (old[j, 1] - old[i, 1]) ** 2
            if apart <= low[row[j]] or apart >= high[row[j]]:
                continue
            if met % every == 0:
                if kept == most:
                    kept = most // 2
                    one[:kept], other[:kept] = one[: 2 * kept : 2].copy(), other[: 2 * kept : 2].copy()
                    every *= 2
                if met % every == 0:
                    one[kept], other[kept] = i, j
                    kept += 1
            met += 1
    return one[:kept], other[:kept]
