"""The floor plan of a simulated world, as an architect cuts it: walls with open doorways, and pillars."""

from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np

from localiser.geometry import Array, ros_from_pose
from localiser.mapping import FloorPlan, map_from_cells
from localiser.simulate import Solids, World, solids_of

CUT_M = 1.2
"""Height above the floor at which a plan shows a building."""
_MARGIN_M = 0.5


def draw_plan(world: World, resolution_m: float, yaw_rad: float = 0.0) -> FloorPlan:
    """Return the plan of a world, cut at `CUT_M`, on a grid whose x axis is turned by `yaw_rad` from the ROS frame's.

    A cell is a wall where its middle is.
    """
    solids = drawn_solids(world)
    nothing = np.zeros((0, 0), dtype=bool)
    turned = FloorPlan(nothing, nothing, resolution_m, np.array([0.0, 0.0, yaw_rad]))
    corners = cells_from_map(turned, solids.corners.reshape(-1, 2))
    low = np.floor(corners.min(axis=0) - _MARGIN_M / resolution_m)
    columns, rows = (int(n) for n in np.ceil(corners.max(axis=0) + _MARGIN_M / resolution_m) - low)
    x, z = map_from_cells(turned, low[None])[0]
    occupied = np.zeros((rows, columns), dtype=bool)
    plan = FloorPlan(occupied, ~occupied, resolution_m, np.array([x, -z, yaw_rad]))
    _fill(occupied, plan, solids)
    return replace(plan, free=~occupied)


def drawn_solids(world: World) -> Solids:
    """Return what a plan of the world shows: no leaves of doors, no pictures, no furniture."""
    walls = tuple(
        wall.model_copy(
            update={"posters": (), "doors": tuple(door.model_copy(update={"leaf": None}) for door in wall.doors)}
        )
        for wall in world.walls
    )
    solids = solids_of(world.model_copy(update={"walls": walls, "furniture": ()}))
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


def write_plan(plan: FloorPlan, path: Path) -> None:
    """Write a plan as map_server has it: YAML, and a PNG beside it."""
    picture = path.with_suffix(".png")
    cv2.imwrite(str(picture), np.where(plan.occupied, 0, np.where(plan.free, 254, 205)).astype(np.uint8)[::-1])
    x, y, yaw = plan.origin_ros.tolist()
    path.write_text(
        f"image: {picture.name}\nresolution: {plan.resolution_m}\norigin: [{x}, {y}, {yaw}]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\nmode: trinary\n"
    )


def cells_from_map(plan: FloorPlan, points: Array) -> Array:
    """Return (K, 2) column, row of the grid at points (K, 2) x, z of the map; the inverse of `map_from_cells`."""
    x, y, yaw = plan.origin_ros
    ros = ros_from_pose(np.concatenate([points, np.zeros((len(points), 1))], axis=1))
    east, north = ros[:, 0] - x, ros[:, 1] - y
    right = np.cos(yaw) * east + np.sin(yaw) * north
    up = -np.sin(yaw) * east + np.cos(yaw) * north
    return np.asarray(np.stack([right, up], axis=-1) / plan.resolution_m)
