"""The loop of `index`, compiled by numba when this module is imported and its function is first called."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.geometry.compiled import entry

Indices = NDArray[np.int64]


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
) -> tuple[Indices, Indices]:
    """Return start (cells + 1,) and item: landmarks item[start[c] : start[c + 1]] can be in view from cell c.

    Never one too few: what a camera sees lies between two planes through it and within range; for a whole cell the
    planes are moved apart by its half diagonal and turned by half its width in heading.
    """
    right, back, yaw = offset
    start, item = np.zeros(len(run), np.int64), np.empty(1024, np.int64)
    half_turn = 0.5 / per_unit[2]
    slack = 0.5 * np.hypot(1.0 / per_unit[0], 1.0 / per_unit[1]) + np.hypot(right, back) * half_turn
    sin_view, cos_view = np.sin(half_view_rad + half_turn), np.cos(half_view_rad + half_turn)
    is_wedge = half_view_rad + half_turn < np.pi / 2
    used = 0
    for c in range(len(run) - 1):
        if run[c + 1] > run[c]:
            if used + len(points) > len(item):
                item = np.concatenate((item, np.empty(len(item) + len(points), np.int64)))
            heading = low[2] + (c % shape[2] + 0.5) / per_unit[2]
            x = low[0] + (c // shape[2] // shape[1] + 0.5) / per_unit[0]
            z = low[1] + (c // shape[2] % shape[1] + 0.5) / per_unit[1]
            x += np.cos(heading) * right + np.sin(heading) * back
            z += np.cos(heading) * back - np.sin(heading) * right
            cos, sin = np.cos(heading + yaw), np.sin(heading + yaw)
            for k in range(len(points)):
                dx, dz = points[k, 0] - x, points[k, 1] - z
                aside, ahead = abs(dx * cos - dz * sin), -(dx * sin + dz * cos)
                inside = dx * dx + dz * dz <= (farthest_m + slack) ** 2
                if is_wedge:
                    inside = inside & (ahead * sin_view - aside * cos_view >= -slack)
                item[used] = k
                used += inside
        start[c + 1] = used
    return start, item[:used]
