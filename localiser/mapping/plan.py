"""Floor plans: a grid of walls and free floor, where it lies in the map, and the corners of walls as landmarks.

The outline is traced along the sides of cells and cut into straight pieces [Douglas, Peucker 1973]. Each piece is
fitted by a robust line, and neighbouring lines meet in the corner. Between two long walls this is more accurate than a
cell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, pose_from_ros
from localiser.landmarks import LandmarkMap

# -- the grid ---------------------------------------------------------------------------------------------------------

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


# -- corners ----------------------------------------------------------------------------------------------------------

MOST_TURNS = 20_000
SMALLEST_M = 0.1  # what covers less than a square of this side is dirt
_SMALLEST_CELLS = 5  # or less than so many cells
_STRAIGHT_CELLS = 1.0  # cells' sides leave the line that they stand for by less
_BUMP_M = 0.05  # what sticks out less is no corner,
_BUMP_CELLS = (1.5, 2.5)  # where that is no less than a cell of noise and no more than two
_FEWEST_TURNS = 3
_TURN_RAD = np.deg2rad(25.0)  # lines that cross at less do not say where
_FIT_CELLS = 25.0  # from so far along a wall, its line near a corner is known
_TRIM_CELLS = 1.0  # so near to a corner, cells belong to either wall
_LINE_SIGMA_CELLS = 0.35  # spread of cells' sides about a line that crosses the grid
_SLANT_CELLS = 2.0  # an end of a short wall may be so far off, and the wall is still at right angles to its neighbour
_APART_CELLS = 4.0  # lines that meet farther than this from where the outline turned do not explain it
_BESIDE_CELLS = 1.5  # a corner must have floor that is known to be free so near
_ROUNDS = 5


def plan_landmarks(plan: FloorPlan, name: str = "", source: str = "plan") -> LandmarkMap:
    """Return the corners of the plan's walls and pillars as landmarks that stand on the floor; there may be none.

    Raises ValueError for more than `MOST_TURNS` turns of the outlines: a picture of something else.
    """
    bump = float(np.clip(_BUMP_M / plan.resolution_m, *_BUMP_CELLS))
    # Walls without specks, and without holes that are as small: a corner that touches is no gap to look through.
    smallest = max(_SMALLEST_CELLS, (SMALLEST_M / plan.resolution_m) ** 2)
    kept = _large(plan.occupied, smallest, connectivity=8)
    occupied = ~_large(~kept, _SMALLEST_CELLS, connectivity=4)
    traced = [(outline, _straight_pieces(outline)) for outline in outlines(occupied)]
    turns = sum(len(pieces) for _, pieces in traced)
    if turns > MOST_TURNS:
        raise ValueError(f"expected walls with at most {MOST_TURNS} corners, found outlines that turn {turns} times")
    corners = [np.zeros((0, 2))]
    for outline, pieces in traced:
        turning = _without_bumps(outline, pieces, bump)
        if len(turning) >= _FEWEST_TURNS:
            corners += [_corners_at(outline, turning, k) for k in range(len(turning))]
    cells = np.concatenate(corners)
    cells = cells[_beside_floor(cells, plan.free & ~occupied)]
    points = map_from_cells(plan, cells)
    # A side of a cell stands anywhere within one cell of the wall that it was drawn for.
    variance = plan.resolution_m**2 / 12
    landmarks = LandmarkMap.from_points(points, name=name, bottom_m=np.zeros(len(points)), source=source)
    return replace(landmarks, cov=np.tile(variance * np.eye(2), (len(points), 1, 1)))


def _large(mask: Mask, smallest: float, connectivity: int) -> Mask:
    _, label, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=connectivity)
    keep = stats[:, cv2.CC_STAT_AREA] >= smallest
    keep[0] = False
    return np.asarray(keep[label])


def outlines(occupied: Mask) -> list[Array]:
    """Return the closed outlines (K, 2) column, row of the cells (H, W), half a cell from point to point.

    Coordinates are those of cells' corners: cell (0, 0) reaches from (0, 0) to (1, 1).
    """
    rows, columns = occupied.shape
    # On a lattice twice as fine, every cell takes in its sides: what OpenCV traces is then the sides themselves.
    fine = np.zeros((2 * rows + 3, 2 * columns + 3), dtype=np.uint8)
    fine[2:-1:2, 2:-1:2] = occupied
    fine = cv2.dilate(fine, np.ones((3, 3), dtype=np.uint8)).astype(np.uint8)
    found, _ = cv2.findContours(fine, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    return [(contour.reshape(-1, 2) - 1).astype(np.float64) / 2 for contour in found if len(contour) > 3]


def _straight_pieces(outline: Array) -> NDArray[np.int64]:
    """Return the indices (C,) of the outline (K, 2) at which it is cut into straight pieces."""
    vertices = cv2.approxPolyDP((2 * outline).astype(np.int32), 2 * _STRAIGHT_CELLS, closed=True).reshape(-1, 2)
    index_of: dict[tuple[int, int], int] = {}
    for index, (column, row) in enumerate((2 * outline).astype(np.int64)):
        index_of.setdefault((int(column), int(row)), index)
    return np.unique([index_of[int(column), int(row)] for column, row in vertices])


def _without_bumps(outline: Array, turns: NDArray[np.int64], bump: float) -> NDArray[np.int64]:
    """Return the turns (C,) without those at which one line explains the pieces before and after: least first."""
    cost = np.array([_deviation(outline, turns, k) for k in range(len(turns))])
    while len(turns) >= _FEWEST_TURNS:
        k = int(np.argmin(cost))
        if cost[k] > bump:
            break
        turns, cost = np.delete(turns, k), np.delete(cost, k)
        for beside in (k - 1, k % len(turns)):
            cost[beside] = _deviation(outline, turns, beside)
    return turns


def _deviation(outline: Array, turns: NDArray[np.int64], k: int) -> float:
    """Return how far (cells) the outline is from one line in place of the two pieces at the k-th turn."""
    begin, end = turns[k - 1], turns[(k + 1) % len(turns)]
    piece = outline[(begin + np.arange((end - begin) % len(outline) + 1)) % len(outline)]
    middle, along = line_through(piece)
    return float(np.abs((piece - middle) @ np.array([-along[1], along[0]])).max())


def _corners_at(outline: Array, turns: NDArray[np.int64], k: int) -> Array:
    """Return where (1, 2) the walls before and after the k-th turn meet, or the two corners (2, 2) of a wall's end."""
    turn = outline[turns[k]]
    before = _beside(outline, int(turns[k]), int(turns[k - 1]), -1)
    after = _beside(outline, int(turns[k]), int(turns[(k + 1) % len(turns)]), 1)
    (point, along), (other, along_other) = _line_from(before), _line_from(after)
    # Both directions lead away from the turn: where they agree, a thin wall ends, and its outline turns back.
    if along @ along_other > np.cos(_TURN_RAD):
        along = (along + along_other) / np.hypot(*(along + along_other))
        # A cell that crosses the wall reaches beyond its end by more than one that lies along it.
        beyond = np.abs(along).sum() - 1.0
        return np.array([side + along * ((turn - side) @ along + beyond) for side in (point, other)])
    if len(before) < len(after):
        along = _squared(along, along_other, len(before))
    else:
        along_other = _squared(along_other, along, len(after))
    normals = np.array([[-along[1], along[0]], [-along_other[1], along_other[0]]])
    if abs(np.linalg.det(normals)) < np.sin(_TURN_RAD):
        return np.asarray(turn[None])
    meeting = np.linalg.solve(normals, (normals * np.array([point, other])).sum(axis=1))
    near = float(np.hypot(*(meeting - turn))) <= _APART_CELLS
    return np.asarray((meeting if near else turn)[None])


def _line_from(points: Array) -> tuple[Array, Array]:
    """Return a point of the line through points (P, 2) and its direction (2,) from the first to the last of them."""
    middle, along = line_through(points)
    return middle, along * (1.0 if along @ (points[-1] - points[0]) >= 0 else -1.0)


def _squared(along: Array, longer: Array, count: int) -> Array:
    """Return the direction (2,) of a wall of `count` points, at right angles to a longer one if it may be."""
    square = np.array([-longer[1], longer[0]])
    angle = np.arccos(np.clip(abs(along @ square), 0.0, 1.0))
    return square if angle < _SLANT_CELLS / (count / 2) else along


def _beside(outline: Array, turn: int, end: int, step: int) -> Array:
    """Return the points (P, 2) of the wall between two turns that are near the first, but not at either."""
    count = (step * (end - turn)) % len(outline)
    trim = int(min(2 * _TRIM_CELLS, (count - 1) // 3))
    reach = min(count - trim, int(2 * _FIT_CELLS))
    return np.asarray(outline[(turn + step * np.arange(trim, reach + 1)) % len(outline)])


def line_through(points: Array) -> tuple[Array, Array]:
    """Return a point (2,) of the line nearest to points (P, 2) by Cauchy's cost, and its direction (2,), a unit."""
    weight = np.ones(len(points))
    for _ in range(_ROUNDS):
        middle = weight @ points / weight.sum()
        offset = points - middle
        along = np.linalg.eigh((offset * weight[:, None]).T @ offset)[1][:, 1]
        across = offset @ np.array([-along[1], along[0]])
        weight = 1.0 / (1.0 + (across / _LINE_SIGMA_CELLS) ** 2)
    return middle, along


def _beside_floor(cells: Array, free: Mask) -> Mask:
    """Return which corners (C,) have free floor beside them: where it is unknown, a wall's far side was made up."""
    column, row = cells.T
    found = np.zeros(len(cells), dtype=bool)
    for dx in (-_BESIDE_CELLS, 0.0, _BESIDE_CELLS):
        for dy in (-_BESIDE_CELLS, 0.0, _BESIDE_CELLS):
            i, j = np.floor(row + dy).astype(np.int64), np.floor(column + dx).astype(np.int64)
            inside = (i >= 0) & (i < free.shape[0]) & (j >= 0) & (j < free.shape[1])
            found[inside] |= free[i[inside], j[inside]]
    return found
