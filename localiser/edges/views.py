"""The image as an ideal pinhole camera would have taken it, with tilt and roll undone so that edges are columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera, RollingShutter
from localiser.geometry import Array
from localiser.geometry.compiled import compiled

Image = NDArray[np.uint8]

_GRID_PX = 8  # spacing of the grid on which lens models are computed; a cubic between errs less than tables do


@lru_cache(maxsize=8)
def half_camera(camera: Camera) -> Camera:
    """Return the cached camera of images in which two rows and two columns have been averaged to one."""
    shutter = camera.shutter
    return replace(
        camera,
        width=camera.width // 2,
        height=camera.height // 2,
        fx=camera.fx / 2,
        fy=camera.fy / 2,
        cx=(camera.cx - 0.5) / 2,
        cy=(camera.cy - 0.5) / 2,
        shutter=shutter and RollingShutter(2 * shutter.row_time_s, (shutter.stamp_row - 0.5) / 2),
    )


def halved(grey: Image) -> Image:
    """Return an image (H, W) with two rows and two columns averaged to one, (H // 2, W // 2), as `half_camera` sees."""
    height, width = grey.shape[0] // 2, grey.shape[1] // 2
    return np.asarray(cv2.resize(grey[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA))


def remap_tables(
    image_from_view: Callable[[Array], Array], size: tuple[int, int], camera: Camera, rows_at_once: int = 1
) -> tuple[NDArray[np.int16], NDArray[np.uint16], NDArray[np.bool_]]:
    """Return tables of `cv2.remap` for a view of `size` (width, height), and (H, W) where `camera` shows nothing.

    image_from_view: image coordinates (..., 2) of pixels (..., 2) of the view, defined a little beyond its border.
    rows_at_once: how many rows of the taken image have been averaged to one before.
    """
    width, height = size
    of_rows, of_columns = _cubic_weights(height), _cubic_weights(width)
    nodes = [_GRID_PX * (np.arange(weights.shape[1]) - 1.0) for weights in (of_columns, of_rows)]
    image_points = image_from_view(np.stack(np.meshgrid(*nodes), axis=-1))
    taken = camera.pixels_from_image(image_points)
    radius = np.linalg.norm(image_points, axis=-1)
    nodes = [taken[..., 0], taken[..., 1], radius]
    u, v, radius = ((of_rows @ values @ of_columns.T).astype(np.float32) for values in nodes)
    # Far outside the field of view a distortion polynomial turns back and would show the image's inside once more; the
    # corners of the image bound what it was fitted for.
    corners = camera.image_from_pixels(camera.border_px().reshape(-1, 2))
    furthest = float(np.linalg.norm(corners, axis=-1).max()) + 1 / camera.focal_px
    shown = (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1) & (radius <= furthest)
    map_1, map_2 = cv2.convertMaps(u, (v - (rows_at_once - 1) / 2) / rows_at_once, cv2.CV_16SC2)
    return np.asarray(map_1, dtype=np.int16), np.asarray(map_2, dtype=np.uint16), ~shown


def _cubic_weights(count: int) -> Array:
    """Return the weights (count, K) of nodes 8 px apart, the first one at -8 px, in a cubic through them."""
    whole, part = np.divmod(np.arange(count) / _GRID_PX, 1.0)
    t = part[:, None] ** np.arange(4)
    # Catmull and Rom's: exact up to the second power.
    cubic = np.array([[0.0, -1.0, 2.0, -1.0], [2.0, 0.0, -5.0, 3.0], [0.0, 1.0, 4.0, -3.0], [0.0, 0.0, -1.0, 1.0]]) / 2
    weights = np.zeros((count, int(whole[-1]) + 4))
    index = whole.astype(np.int64)[:, None] + np.arange(4)
    np.put_along_axis(weights, index, t @ cubic.T, axis=1)
    return weights


# -- with tilt and roll undone ----------------------------------------------------------------------------------------

ROWS_AT_ONCE = 2  # rows of the image that become one of the rectified one, averaged beforehand: half as much to look up
ROWS_PER_BLOCK = 4  # the height of the rectified image is a multiple of this: rows that are averaged to one
_AROUND_COLUMNS = 8  # columns outside the visible part that are looked up too, because filters reach that far
_WIDEST = 2.5  # limit of the rectified width over the image's; only a view of the nadir point itself would want more
_STEEPEST_TANGENT = 3.0  # largest |tan b| (72°): edges farther to the side cross the image's corner at most
_LEAST_DEPTH = 0.05  # least c + e s: nearer to the nadir point all bearings meet


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
        return compiled(blocks_loop)(compiled(corners_loop)(image), self.table)


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

    def image_from_grid(pixels: Array) -> Array:
        return camera.image_from_upright(grid.upright(pixels[..., 0], pixels[..., 1]))

    map_1, map_2, unseen = remap_tables(image_from_grid, (width, height), camera, ROWS_AT_ONCE)
    unseen |= (grid.depth(np.arange(float(height))) < _LEAST_DEPTH)[:, None]  # beyond the nadir point
    paired_shape = (camera.height // ROWS_AT_ONCE, camera.width)
    return ColumnView(**asdict(grid), unseen=unseen, table=_table_of(map_1, map_2, unseen, paired_shape))


def corners_loop(image: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Return an image (H, W) with two rows averaged to one, halves rounded to even, as squares (H // 2 - 1, W).

    A square is four pixels in the bytes of one number, the lowest the upper left, then the upper right, the lower left
    and the lower right, to be looked up at once. There is none in the last column.
    """
    paired = np.empty((image.shape[0] // 2, image.shape[1]), np.uint8)
    for r in range(paired.shape[0]):
        for c in range(paired.shape[1]):
            both = np.uint16(image[2 * r, c]) + np.uint16(image[2 * r + 1, c])
            paired[r, c] = (both + ((both >> 1) & 1)) >> 1
    corners = np.zeros((paired.shape[0] - 1, paired.shape[1]), np.uint32)
    for r in range(corners.shape[0]):
        for c in range(corners.shape[1] - 1):
            upper = np.uint32(paired[r, c]) | np.uint32(paired[r, c + 1]) << np.uint32(8)
            lower = np.uint32(paired[r + 1, c]) | np.uint32(paired[r + 1, c + 1]) << np.uint32(8)
            corners[r, c] = upper | lower << np.uint32(16)
    return corners


def blocks_loop(corners: NDArray[np.uint32], table: Table) -> NDArray[np.float32]:
    """Return the squares of an image looked up by a table, averaged over blocks of rows: (B, W).

    It is 0 outside columns first … last. Bilinear in whole numbers, which float32 holds exactly. One loop only looks
    up; the other works along memory, which compilers make parallel where indices cannot be negative.
    """
    corner, right, down, first, last = table
    flat, square = corners.ravel(), np.zeros(corner.shape[1], np.uint32)
    grey = np.zeros((len(first), corner.shape[1]), np.float32)
    side, half = np.float32(32), np.float32(0.5)
    for b in range(len(first)):
        low, high = np.uint64(first[b]), np.uint64(last[b])
        for r in range(b * ROWS_PER_BLOCK, (b + 1) * ROWS_PER_BLOCK):
            for c in range(low, high):
                square[c] = flat[corner[r, c]]
            for c in range(low, high):
                four, x, y = square[c], np.float32(right[r, c]), np.float32(down[r, c])
                upper_left, upper_right = np.float32(np.uint8(four)), np.float32(np.uint8(four >> np.uint32(8)))
                lower_left, lower_right = np.float32(np.uint8(four >> np.uint32(16))), np.float32(four >> np.uint32(24))
                upper = upper_left * side + (upper_right - upper_left) * x
                lower = lower_left * side + (lower_right - lower_left) * x
                grey[b, c] += np.floor((upper * side + (lower - upper) * y) / (side * side) + half)
        for c in range(low, high):
            grey[b, c] /= np.float32(ROWS_PER_BLOCK)
    return grey
