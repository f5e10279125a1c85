"""Which landmarks can be in view from where: lists by cell of the floor and by heading, made once for a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, wrap_angle

Indices = NDArray[np.int64]

CELL_M = 0.5
HEADINGS = 32


@dataclass(frozen=True, slots=True, eq=False)
class Sectors:
    """Lists of landmarks for cameras in each cell (X, Z) of the floor and each of H headings.

    corner: (2,) lowest x, z. shape: X, Z, H. start: (X·Z·H + 1,) and item: the list of cell k is
    item[start[k] : start[k + 1]], with k = (x · Z + z) · H + heading. A list may hold a few landmarks too many, never
    one too few. Outside the cells there are none.
    """

    corner: Array
    shape: tuple[int, int, int]
    start: Indices
    item: NDArray[np.int32]

    @classmethod
    def of(cls, points: Array, low: Array, high: Array, half_view_rad: float, range_max_m: float) -> Sectors:
        """Return the lists of landmarks (L, 2) for cameras between the corners `low` and `high` (2,) of the floor."""
        size = np.maximum(np.ceil((high - low) / CELL_M), 1).astype(np.int64)
        columns, rows = (low[axis] + (np.arange(size[axis]) + 0.5) * CELL_M for axis in (0, 1))
        width = 2 * np.pi / HEADINGS
        heading = -np.pi + (np.arange(HEADINGS) + 0.5) * width
        half_diagonal = CELL_M / np.sqrt(2)
        counts, items = [], []
        for x in columns:  # one row of cells at a time bounds the memory
            dx, dz = points[:, 0] - x, points[:, 1] - rows[:, None]
            distance = np.hypot(dx, dz)
            # A landmark straight ahead of heading h lies at (-sin h, -cos h); a cell widens what it sees by its size.
            reach = half_view_rad + width / 2 + np.arcsin(np.minimum(half_diagonal / np.maximum(distance, 1e-9), 1.0))
            off = np.abs(wrap_angle(np.arctan2(-dx, -dz)[:, None] - heading[:, None]))
            seen = (off <= reach[:, None]) | (distance <= half_diagonal)[:, None]
            seen &= (distance <= range_max_m + half_diagonal)[:, None]
            counts.append(seen.sum(axis=-1).ravel())
            items.append(np.nonzero(seen)[2].astype(np.int32))  # millions of entries on a large floor
        start = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
        return cls(low, (int(size[0]), int(size[1]), HEADINGS), start, np.concatenate(items))
