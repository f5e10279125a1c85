"""A floor plan as a grid: which cells are walls, which are free floor, and where they lie in the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, pose_from_ros, ros_from_pose

Mask = NDArray[np.bool_]

MOST_CELLS = 2**25
"""What is worked on at once: 5800 cells square, 290 m at 5 cm."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorPlan:
    """A grid of cells seen from above, as ROS has it: columns along its x axis, rows along its y axis.

    occupied, free: (H, W) bool, row 0 at the bottom; what is neither is unknown. resolution_m: side of a cell.
    origin_ros: (3,) x, y, yaw in the ROS frame of the outer corner of cell (0, 0).
    """

    occupied: Mask
    free: Mask
    resolution_m: float
    origin_ros: Array

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.occupied.shape[0], self.occupied.shape[1]


def map_from_cells(plan: FloorPlan, cells: Array) -> Array:
    """Return points (K, 2) x, z of the map at (K, 2) column, row of the grid: cell (0, 0) ends at (1, 1)."""
    x, y, yaw = plan.origin_ros
    right, up = plan.resolution_m * cells[:, 0], plan.resolution_m * cells[:, 1]
    ros_x = x + np.cos(yaw) * right - np.sin(yaw) * up
    ros_y = y + np.sin(yaw) * right + np.cos(yaw) * up
    return np.asarray(pose_from_ros(np.stack([ros_x, ros_y, np.zeros(len(cells))], axis=-1))[:, :2])


def cells_from_map(plan: FloorPlan, points: Array) -> Array:
    """Return (K, 2) column, row of the grid at points (K, 2) x, z of the map; the inverse of `map_from_cells`."""
    x, y, yaw = plan.origin_ros
    ros = ros_from_pose(np.concatenate([points, np.zeros((len(points), 1))], axis=1))
    east, north = ros[:, 0] - x, ros[:, 1] - y
    right = np.cos(yaw) * east + np.sin(yaw) * north
    up = -np.sin(yaw) * east + np.cos(yaw) * north
    return np.asarray(np.stack([right, up], axis=-1) / plan.resolution_m)
