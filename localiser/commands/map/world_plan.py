"""The floor plan of a simulated world, as an architect cuts it: walls with open doorways, and pillars."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from localiser.errors import InputError
from localiser.mapping import MOST_CELLS, FloorPlan, cells_from_map, map_from_cells
from localiser.simulate import Solids, World, solids_of

CUT_M = 1.2
"""Height above the floor at which a plan shows a building."""
_MARGIN_M = 0.5


def draw_plan(world: World, resolution_m: float, yaw_rad: float = 0.0, *, furniture: bool = False) -> FloorPlan:
    """Return the plan of a world, cut at `CUT_M`, on a grid whose x axis is turned by `yaw_rad` from the ROS frame's.

    A cell is a wall where its middle is. Raises InputError for a world with nothing to draw, or too fine a grid.
    """
    solids = drawn_solids(world, furniture=furniture)
    if not len(solids):
        raise InputError(f"expected walls or posts that reach {CUT_M} m, found none", field="walls")
    nothing = np.zeros((0, 0), dtype=bool)
    turned = FloorPlan(nothing, nothing, resolution_m, np.array([0.0, 0.0, yaw_rad]))
    corners = cells_from_map(turned, solids.corners.reshape(-1, 2))
    low = np.floor(corners.min(axis=0) - _MARGIN_M / resolution_m)
    columns, rows = (int(n) for n in np.ceil(corners.max(axis=0) + _MARGIN_M / resolution_m) - low)
    if columns * rows > MOST_CELLS:
        raise InputError(f"expected a plan of at most {MOST_CELLS} cells, found {columns}×{rows}", field="--resolution")
    x, z = map_from_cells(turned, low[None])[0]
    occupied = np.zeros((rows, columns), dtype=bool)
    plan = FloorPlan(occupied, ~occupied, resolution_m, np.array([x, -z, yaw_rad]))
    _fill(occupied, plan, solids)
    return replace(plan, free=~occupied)


def drawn_solids(world: World, *, furniture: bool = False) -> Solids:
    """Return what a plan of the world shows: no leaves of doors, no pictures, furniture where asked for."""
    walls = tuple(
        wall.model_copy(
            update={"posters": (), "doors": tuple(door.model_copy(update={"leaf": None}) for door in wall.doors)}
        )
        for wall in world.walls
    )
    solids = solids_of(world.model_copy(update={"walls": walls, "furniture": world.furniture if furniture else ()}))
    cut = np.flatnonzero((solids.bottom_m <= CUT_M) & (solids.top_m > CUT_M))
    columns = {field.name: getattr(solids, field.name) for field in fields(solids) if field.name != "material"}
    return Solids(material=tuple(solids.material[k] for k in cut), **{name: c[cut] for name, c in columns.items()})


def _fill(occupied: np.ndarray, plan: FloorPlan, solids: Solids) -> None:
    """Mark the cells of the plan whose middle lies in a solid."""
    normals, offsets = solids.half_planes()
    for corners, normal, offset in zip(solids.corners, normals, offsets, strict=True):
        cells = cells_from_map(plan, corners)
        (left, bottom), (right, top) = np.floor(cells.min(axis=0)).astype(int), np.ceil(cells.max(axis=0)).astype(int)
        column, row = np.meshgrid(np.arange(left, right), np.arange(bottom, top))
        points = map_from_cells(plan, np.stack([column.ravel(), row.ravel()], axis=-1) + 0.5)
        inside = (points @ normal.T <= offset).all(axis=1).reshape(column.shape)
        occupied[bottom:top, left:right] |= inside
