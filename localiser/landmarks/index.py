"""Landmarks by cell of floor and heading: which of them can be in view from where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.landmarks.reach import Reach

Indices = NDArray[np.int64]

CELL_M = 0.5
HEADINGS = 32
MOST_CELLS = 400_000  # in a table; larger ones on a larger floor, whose lists hold more that is not in view


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkIndex:
    """Lists of landmarks for cameras in each cell (X, Z) of the floor and each of H headings.

    corner: (2,) lowest x, z. cell_m: side of a cell. shape: X, Z, H. start: (X·Z·H + 1,) and item: the list of cell k
    is item[start[k] : start[k + 1]], with k = (x · Z + z) · H + heading. A list may hold a few landmarks too many,
    never one too few. Outside the cells there are none.
    """

    corner: Array
    cell_m: float
    shape: tuple[int, int, int]
    start: Indices
    item: NDArray[np.int32]

    @classmethod
    def of(cls, points: Array, low: Array, high: Array, half_view_rad: float, range_max_m: float) -> LandmarkIndex:
        """Return the lists of landmarks (L, 2) for cameras between the corners `low` and `high` (2,) of the floor."""
        cell_m, headings = CELL_M, HEADINGS
        while (np.ceil((high - low) / cell_m).prod() * headings) > MOST_CELLS:
            cell_m, headings = 2.0 * cell_m, HEADINGS // 2
        columns, rows = np.maximum(np.ceil((high - low) / cell_m), 1).astype(np.int64).tolist()
        shape = (columns, rows, headings)
        every = np.arange(columns * rows * headings + 1)
        corner, per_unit = np.array([*low, -np.pi]), np.array([1 / cell_m, 1 / cell_m, headings / (2 * np.pi)])
        reach = Reach.of(points, range_max_m + cell_m)
        start, item = in_view_of_cells(
            every, corner, per_unit, np.array(shape), points, half_view_rad, range_max_m, reach
        )
        return cls(low, cell_m, shape, start, item)


def in_view_of_cells(
    run: Indices,
    low: Array,
    per_unit: Array,
    shape: Indices,
    points: Array,
    half_view_rad: float,
    range_max_m: float,
    reach: Reach,
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[Indices, NDArray[np.int32]]:
    """Return start (cells + 1,) and item: landmarks item[start[c] : start[c + 1]] can be in view from cell c.

    run: (cells + 1,) ascending; cells that it does not grow by are left empty. Cells start at `low` (3,) x, z, heading,
    per_unit (3,) in a unit, shape (3,) in all. points: (L, 2 or more) x, z. reach: of the same landmarks; where cells
    are larger than it is made for, all landmarks are looked at. offset: of the camera from the poses that are meant:
    right, back (m), yaw (rad).
    """
    from localiser.landmarks import index_kernel as kernel

    slack = 0.5 * np.hypot(*(1.0 / per_unit[:2])) + np.hypot(*offset[:2]) * 0.5 / per_unit[2]
    if range_max_m + slack > reach.radius_m:
        reach = Reach.everything(len(points))
    points = np.ascontiguousarray(points, dtype=np.float64)
    return kernel.in_view_of_cells(
        run, low, per_unit, shape, offset, points, half_view_rad, range_max_m, *reach.arguments
    )
