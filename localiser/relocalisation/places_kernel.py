"""The loops of `places`, compiled by numba when this module is imported and its functions are first called."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.geometry.compiled import compiled

Indices = NDArray[np.int64]

_RINGS = 256  # of distances, of which the farthest are left out when there are too many pairs


@compiled
def pairs_within(
    points: Array,
    farthest_m: float,
    most: int,
    low: Array,
    per_m: float,
    shape: tuple[int, int],
    start: Indices,
    item: NDArray[np.int32],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return first (M,) and second (M,) of all ordered pairs about as far apart as that or less, ascending.

    At most so many: else those farthest apart are left out. low, per_m, shape, start, item: see `landmarks.Reach`.
    """
    limit = farthest_m * farthest_m * (1.0 + 1e-9)
    ring = np.zeros(_RINGS + 1, np.int64)
    first, second = np.empty(0, np.int32), np.empty(0, np.int32)
    rings, used = _RINGS + 1, 0
    for is_writing in (False, True):
        for k in range(len(points)):
            x, z = points[k, 0], points[k, 1]
            i, j = int(np.floor((x - low[0]) * per_m)), int(np.floor((z - low[1]) * per_m))
            piece = i * shape[1] + j
            for place in range(start[piece], start[piece + 1]):
                other = item[place]
                dx, dz = points[other, 0] - x, points[other, 1] - z
                square = dx * dx + dz * dz
                if other != k and square <= limit:
                    at = int(np.sqrt(square / limit) * _RINGS)
                    if not is_writing:
                        ring[at] += 1
                    elif at < rings:
                        first[used], second[used] = k, other
                        used += 1
        if not is_writing:
            rings, total = 0, 0
            while rings <= _RINGS and total + ring[rings] <= most:
                total += ring[rings]
                rings += 1
            first, second = np.empty(total, np.int32), np.empty(total, np.int32)
    return first, second
