"""The image as an ideal pinhole camera would have taken it, with tilt and roll undone so that edges are columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera, RollingShutter
from localiser.geometry import Array

Image = NDArray[np.uint8]

_GRID_PX = 8  # spacing of the grid on which lens models are computed; a cubic between errs less than tables do


@lru_cache(maxsize=8)
def half_camera(camera: Camera) -> Camera:
    """Return the cached camera of images in which two rows and two columns have been averaged to one."""
    return replace(
        camera,
        width=camera.width // 2,
        height=camera.height // 2,
        fx=camera.fx / 2,
        fy=camera.fy / 2,
        cx=(camera.cx - 0.5) / 2,
        cy=(camera.cy - 0.5) / 2,
        shutter=camera.shutter and RollingShutter(2 * camera.shutter.row_time_s, (camera.shutter.stamp_row - 0.5) / 2),
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


ROWS_AT_ONCE = 2  # rows of the image that become one of the rectified one, averaged beforehand: half as much to look up
ROWS_PER_BLOCK = 4  # the height of the rectified image is a multiple of this: rows that are averaged to one
_WIDEST = 2.5  # limit of the rectified width over the image's; only a view of the nadir point itself would want more
_STEEPEST_TANGENT = 3.0  # largest |tan b| (72°): edges farther to the side cross the image's corner at most
_LEAST_DEPTH = 0.05  # least c + e s: nearer to the nadir point all bearings meet


@dataclass(frozen=True, eq=False)
class ColumnView:
    """A remap of the image of a camera: the column is tan(bearing), the row the height e in the upright image.

    A vertical edge a = tan b (c + e s) is a column, whatever the tilt. Rows are half as dense as in the image, columns
    as dense as at the image's centre for a tilt of 0.

    first_tangent, first_height: of the top-left pixel. columns_per_tangent: pixels per unit. width, height: in pixels.
    """

    camera: Camera
    first_tangent: float
    first_height: float
    columns_per_tangent: float
    width: int
    height: int

    def upright(self, column: Array, row: Array) -> Array:
        """Return upright image coordinates (a, e) (..., 2) of pixels of the rectified image."""
        return np.stack([self.tangent(column) * self.depth(row), self._e(row)], axis=-1)

    def _e(self, row: Array) -> Array:
        return np.asarray(self.first_height - row / (self.camera.focal_px / ROWS_AT_ONCE))

    def tangent(self, column: Array) -> Array:
        """Return tan(bearing) of columns."""
        return np.asarray(self.first_tangent + column / self.columns_per_tangent)

    def depth(self, row: Array) -> Array:
        """Return c + e s of rows."""
        tilt_rad = self.camera.mount.tilt_rad
        return np.asarray(np.cos(tilt_rad) + self._e(row) * np.sin(tilt_rad))

    @cached_property
    def tables(self) -> tuple[NDArray[np.int16], NDArray[np.uint16], NDArray[np.bool_]]:
        """The tables of `cv2.remap` from an image of paired rows, and (H, W) where the image has nothing to show."""

        def image_from_view(pixels: Array) -> Array:
            return self.camera.image_from_upright(self.upright(pixels[..., 0], pixels[..., 1]))

        map_1, map_2, unseen = remap_tables(image_from_view, (self.width, self.height), self.camera, ROWS_AT_ONCE)
        beyond_nadir = self.depth(np.arange(float(self.height))) < _LEAST_DEPTH
        return map_1, map_2, unseen | beyond_nadir[:, None]

    def blocks(self, image: Image) -> NDArray[np.float32]:
        """Return the rectified image of a taken one (H, W), averaged over blocks of rows: (B, W) grey levels."""
        paired = cv2.addWeighted(image[: len(image) - 1 : 2], 0.5, image[1::2], 0.5, 0.0)
        rows = cv2.remap(paired, *self.tables[:2], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(rows.reshape(-1, ROWS_PER_BLOCK, self.width).mean(axis=1, dtype=np.float32))


@lru_cache(maxsize=8)
def column_view(camera: Camera) -> ColumnView:
    """Return the cached view of `camera` that holds all vertical edges ahead."""
    border = camera.upright_from_pixels(camera.border_px().reshape(-1, 2))
    tilt, focal = camera.mount.tilt_rad, camera.focal_px
    depth = np.cos(tilt) + border[:, 1] * np.sin(tilt)
    border, depth = border[depth > _LEAST_DEPTH], depth[depth > _LEAST_DEPTH]
    border[:, 1] = border[:, 1].clip(-_STEEPEST_TANGENT, _STEEPEST_TANGENT)  # of a fisheye's corner it may be 1e16
    tangent = (border[:, 0] / depth).clip(-_STEEPEST_TANGENT, _STEEPEST_TANGENT)
    density = min(focal, _WIDEST * camera.width / float(np.ptp(tangent)))
    width = int(np.ceil(np.ptp(tangent) * density)) + 1
    height = ROWS_PER_BLOCK * int(np.ceil(np.ptp(border[:, 1]) * focal / ROWS_AT_ONCE / ROWS_PER_BLOCK))
    first_height = float(border[:, 1].max()) - (ROWS_AT_ONCE - 1) / 2 / focal
    return ColumnView(camera, float(tangent.min()), first_height, density, width, height)
