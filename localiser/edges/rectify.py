"""The image with lens distortion, tilt and roll undone at once, so that vertical edges are columns."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges.columns_kernel import blocks_loop, corners_loop
from localiser.edges.undistort import Image, remap_tables
from localiser.geometry import Array
from localiser.geometry.compiled import compiled

ROWS_AT_ONCE = 2
"""Rows of the image that become one of the rectified one, averaged beforehand: half as much to look up."""
ROWS_PER_BLOCK = 4
"""The height of the rectified image is a multiple of this: rows that are averaged to one."""
_AROUND_COLUMNS = 8
"""Columns outside the visible part that are looked up too, because filters reach that far."""
_WIDEST = 2.5
"""Limit of the rectified width over the image's; only a view of the nadir point itself would want more."""
_STEEPEST_TANGENT = 3.0
"""Largest |tan b| that is kept (72°): vertical edges farther to the side cross the image's corner at most."""
_LEAST_DEPTH = 0.05
"""Least c + e s: nearer to the nadir point all bearings meet."""


class Table(NamedTuple):
    """In which square of four pixels of an image of paired rows each pixel (H, W) of a view lies.

    corner: (H, W) flat index of the square, that of its upper left pixel. right, down: (H, W) how far on from there, in
    1/32 px. first, last: (B,) columns of each block from which, and up to which, there is something to see.
    """

    corner: NDArray[np.int32]
    right: NDArray[np.uint8]
    down: NDArray[np.uint8]
    first: NDArray[np.int64]
    last: NDArray[np.int64]


def _table_of(
    map_1: NDArray[np.int16], map_2: NDArray[np.uint16], unseen: NDArray[np.bool_], shape: tuple[int, int]
) -> Table:
    """Return the table of maps of `cv2.remap` for images of `shape`; outside, the border goes on."""
    whole, share = map_1[..., ::-1].astype(np.int64), np.stack([map_2 >> 5, map_2 & 31], axis=-1)
    most = np.array(shape) - 2
    row, column = np.moveaxis(whole.clip(0, most), -1, 0)
    down, right = np.moveaxis(np.where(whole < 0, 0, np.where(whole > most, 32, share)).astype(np.uint8), -1, 0)
    seen: NDArray[np.bool_] = ~np.all(unseen.reshape(-1, ROWS_PER_BLOCK, unseen.shape[1]), axis=1)
    first, last = seen.argmax(axis=1), seen.shape[1] - seen[:, ::-1].argmax(axis=1)
    first = np.maximum(first - _AROUND_COLUMNS, 0)
    last = np.where(np.any(seen, axis=1), np.minimum(last + _AROUND_COLUMNS, seen.shape[1]), 0)
    corner = (row * shape[1] + column).astype(np.int32)
    return Table(corner, np.ascontiguousarray(right), np.ascontiguousarray(down), first, last)


@dataclass(frozen=True, slots=True, eq=False)
class ColumnGrid:
    """Pixels of a remap of the taken image: the column is tan(bearing), the row the height e in the upright image.

    A vertical edge a = tan b (c + e s) is a column, whatever the tilt. Rows are half as dense as in the image, columns
    as dense as at the image's centre for a tilt of 0.

    first_tangent, first_height: of the top-left pixel. columns_per_tangent, rows_per_height: pixels per unit.
    """

    tilt_rad: float
    first_tangent: float
    first_height: float
    columns_per_tangent: float
    rows_per_height: float

    def upright(self, column: Array, row: Array) -> Array:
        """Return upright image coordinates (a, e) (..., 2) of pixels of the rectified image."""
        e = self.first_height - row / self.rows_per_height
        return np.stack([self.tangent(column) * self.depth(row), e], axis=-1)

    def tangent(self, column: Array) -> Array:
        """Return tan(bearing) of columns."""
        return np.asarray(self.first_tangent + column / self.columns_per_tangent)

    def depth(self, row: Array) -> Array:
        """Return c + e s of rows."""
        e = self.first_height - row / self.rows_per_height
        return np.asarray(np.cos(self.tilt_rad) + e * np.sin(self.tilt_rad))

    def pixels_per_column(self, column: Array, row: Array) -> Array:
        """Return how many pixels of the taken image, across a vertical edge, one column is wide."""
        lean = np.arctan(np.sin(self.tilt_rad) * self.tangent(column))
        per_tangent = self.depth(row) * np.cos(lean) * self.rows_per_height * ROWS_AT_ONCE
        return np.asarray(per_tangent / self.columns_per_tangent)


@dataclass(frozen=True, slots=True, eq=False)
class ColumnView(ColumnGrid):
    """The remap of the image of a camera.

    unseen: (H, W) where the taken image has nothing to show. table: where each pixel (H, W) is looked up.
    """

    unseen: NDArray[np.bool_]
    table: Table

    def blocks(self, image: Image) -> NDArray[np.float32]:
        """Return the rectified image of a taken one (H, W), averaged over blocks of rows: (B, W) grey levels."""
        return compiled(blocks_loop)(compiled(corners_loop)(image), *self.table, ROWS_PER_BLOCK)


@lru_cache(maxsize=8)
def column_view(camera: Camera) -> ColumnView:
    """Return the cached view of `camera` that holds all vertical edges ahead."""
    border = camera.upright_from_pixels(camera.border_px().reshape(-1, 2))
    tilt, focal = camera.mount.tilt_rad, camera.focal_px
    depth = np.cos(tilt) + border[:, 1] * np.sin(tilt)
    border, depth = border[depth > _LEAST_DEPTH], depth[depth > _LEAST_DEPTH]
    tangent = (border[:, 0] / depth).clip(-_STEEPEST_TANGENT, _STEEPEST_TANGENT)
    density = min(focal, _WIDEST * camera.width / float(np.ptp(tangent)))
    width = int(np.ceil(np.ptp(tangent) * density)) + 1
    height = ROWS_PER_BLOCK * int(np.ceil(np.ptp(border[:, 1]) * focal / ROWS_AT_ONCE / ROWS_PER_BLOCK))
    first_height = float(border[:, 1].max()) - (ROWS_AT_ONCE - 1) / 2 / focal
    grid = ColumnGrid(tilt, float(tangent.min()), first_height, density, focal / ROWS_AT_ONCE)
    map_1, map_2, unseen = remap_tables(
        lambda pixels: camera.image_from_upright(grid.upright(pixels[..., 0], pixels[..., 1])),
        (width, height),
        camera,
        rows_at_once=ROWS_AT_ONCE,
    )
    beyond_nadir = grid.depth(np.arange(float(height))) < _LEAST_DEPTH
    unseen |= beyond_nadir[:, None]
    paired_shape = (camera.height // ROWS_AT_ONCE, camera.width)
    return ColumnView(**asdict(grid), unseen=unseen, table=_table_of(map_1, map_2, unseen, paired_shape))
