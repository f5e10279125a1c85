"""The loops of `index` and `reach`, compiled by numba when this module is imported and they are first called."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.geometry.compiled import compiled, entry

Indices = NDArray[np.int64]


@compiled
def within_reach(
    points: Array, low: Array, piece_m: float, shape: tuple[int, int], radius_m: float
) -> tuple[Indices, NDArray[np.int32]]:
    """Return start (X·Z + 1,) and item: the landmarks within a radius of any point of each piece of the floor."""
    columns, rows = shape
    start = np.zeros(columns * rows + 2, np.int64)
    item = np.empty(0, np.int32)
    for is_writing in (False, True):
        for k in range(len(points)):
            x, z = points[k, 0] - low[0], points[k, 1] - low[1]
            first, last = int((x - radius_m) / piece_m), int((x + radius_m) / piece_m)
            for i in range(max(first, 0), min(last, columns - 1) + 1):
                aside = max(i * piece_m - x, x - (i + 1) * piece_m, 0.0)
                left = np.sqrt(max(radius_m * radius_m - aside * aside, 0.0))
                begin, end = int((z - left) / piece_m), int((z + left) / piece_m)
                for j in range(max(begin, 0), min(end, rows - 1) + 1):
                    piece = i * rows + j
                    if is_writing:
                        item[start[piece + 1]] = k
                        start[piece + 1] += 1
                    else:
                        start[piece + 2] += 1
        if not is_writing:
            for piece in range(len(start) - 1):
                start[piece + 1] += start[piece]
            item = np.empty(start[len(start) - 1], np.int32)
    return start[:-1].copy(), item


@entry
def in_view_of_cells(
    run: Indices,
    low: Array,
    per_unit: Array,
    shape: Indices,
    offset: tuple[float, float, float],
    points: Array,
    half_view_rad: float,
    farthest_m: float,
    reach_low: Array,
    reach_per_m: float,
    reach_shape: tuple[int, int],
    reach_start: Indices,
    reach_item: NDArray[np.int32],
) -> tuple[Indices, NDArray[np.int32]]:
    """Return start (cells + 1,) and item: landmarks item[start[c] : start[c + 1]] can be in view from cell c.

    Never one too few: what a camera sees lies between two planes through it and within range; for a whole cell the
    planes are moved apart by its half diagonal and turned by half its width in heading. reach_…: see `reach.Reach`.
    """
    right, back, yaw = offset
    start, item = np.zeros(len(run), np.int64), np.empty(1024, np.int32)
    half_turn = 0.5 / per_unit[2]
    slack = 0.5 * np.hypot(1.0 / per_unit[0], 1.0 / per_unit[1]) + np.hypot(right, back) * half_turn
    sin_view, cos_view = np.sin(half_view_rad + half_turn), np.cos(half_view_rad + half_turn)
    is_wedge = half_view_rad + half_turn < np.pi / 2
    used = 0
    for c in range(len(run) - 1):
        if run[c + 1] > run[c]:
            heading = low[2] + (c % shape[2] + 0.5) / per_unit[2]
            x = low[0] + (c // shape[2] // shape[1] + 0.5) / per_unit[0]
            z = low[1] + (c // shape[2] % shape[1] + 0.5) / per_unit[1]
            x += np.cos(heading) * right + np.sin(heading) * back
            z += np.cos(heading) * back - np.sin(heading) * right
            cos, sin = np.cos(heading + yaw), np.sin(heading + yaw)
            i, j = np.floor((x - reach_low[0]) * reach_per_m), np.floor((z - reach_low[1]) * reach_per_m)
            first, last = 0, 0
            if i >= 0 and j >= 0 and i < reach_shape[0] and j < reach_shape[1]:
                piece = int(i) * reach_shape[1] + int(j)
                first, last = reach_start[piece], reach_start[piece + 1]
            if used + last - first > len(item):
                item = np.concatenate((item, np.empty(len(item) + last - first, np.int32)))
            for place in range(first, last):
                k = reach_item[place]
                dx, dz = points[k, 0] - x, points[k, 1] - z
                aside, ahead = abs(dx * cos - dz * sin), -(dx * sin + dz * cos)
                inside = dx * dx + dz * dz <= (farthest_m + slack) ** 2
                if is_wedge:
                    inside = inside & (ahead * sin_view - aside * cos_view >= -slack)
                item[used] = k
                used += inside
        start[c + 1] = used
    return start, item[:used].copy()
