"""The image with lens distortion, tilt and roll undone at once, so that vertical edges are columns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges.undistort import Image, image_border, remap_tables
from localiser.geometry import Array

ROWS_AT_ONCE = 2
"""Rows of the image that become one of the rectified one, averaged beforehand: half as much to look up."""
ROWS_PER_BLOCK = 4
"""The height of the rectified image is a multiple of this: rows that are averaged to one."""
_WIDEST = 2.5
"""Limit of the rectified width over the image's; only a view of the nadir point itself would want more."""
_STEEPEST_TANGENT = 3.0
"""Largest |tan b| that is kept: vertical edges beside the camera (72°) cross the image's corner at most."""
_LEAST_DEPTH = 0.05
"""Least c + e s: nearer to the nadir point all bearings meet."""


@dataclass(frozen=True, slots=True, eq=False)
class ColumnView:
    """A remap of the taken image in which the column is tan(bearing) and the row the height e in the upright image.

    A vertical edge a = tan b (c + e s) is a column, whatever the tilt. Rows are half as dense as in the image, columns
    as dense as at the image's centre for a tilt of 0.

    first_tangent, first_height: of the top-left pixel. columns_per_tangent, rows_per_height: pixels per unit.
    map_1, map_2: tables of `cv2.remap`. unseen: (H, W) where the taken image has nothing to show.
    """

    tilt_rad: float
    first_tangent: float
    first_height: float
    columns_per_tangent: float
    rows_per_height: float
    map_1: NDArray[np.int16]
    map_2: NDArray[np.uint16]
    unseen: NDArray[np.bool_]

    def of(self, image: Image) -> Image:
        """Return the rectified image (H, W) of a taken one."""
        height = image.shape[0] // ROWS_AT_ONCE
        paired = cv2.resize(image[: height * ROWS_AT_ONCE], (image.shape[1], height), interpolation=cv2.INTER_AREA)
        rectified = cv2.remap(paired, self.map_1, self.map_2, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(rectified, dtype=np.uint8)

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


@lru_cache(maxsize=8)
def column_view(camera: Camera) -> ColumnView:
    """Return the cached view of `camera` that holds all vertical edges ahead."""
    border = camera.upright_from_pixels(image_border(camera))
    tilt, focal = camera.mount.tilt_rad, camera.focal_px
    depth = np.cos(tilt) + border[:, 1] * np.sin(tilt)
    border, depth = border[depth > _LEAST_DEPTH], depth[depth > _LEAST_DEPTH]
    tangent = (border[:, 0] / depth).clip(-_STEEPEST_TANGENT, _STEEPEST_TANGENT)
    density = min(focal, _WIDEST * camera.width / float(np.ptp(tangent)))
    width = int(np.ceil(np.ptp(tangent) * density)) + 1
    height = ROWS_PER_BLOCK * int(np.ceil(np.ptp(border[:, 1]) * focal / ROWS_AT_ONCE / ROWS_PER_BLOCK))
    empty = np.zeros((0, 0))
    first_height = float(border[:, 1].max()) - (ROWS_AT_ONCE - 1) / 2 / focal
    view = ColumnView(
        tilt, float(tangent.min()), first_height, density, focal / ROWS_AT_ONCE,
        empty.astype(np.int16), empty.astype(np.uint16), empty.astype(np.bool_),
    )  # fmt: skip
    map_1, map_2, unseen = remap_tables(
        lambda pixels: camera.image_from_upright(view.upright(pixels[..., 0], pixels[..., 1])),
        (width, height),
        camera,
        rows_at_once=ROWS_AT_ONCE,
    )
    beyond_nadir = view.depth(np.arange(float(height))) < _LEAST_DEPTH
    return replace(view, map_1=map_1, map_2=map_2, unseen=unseen | beyond_nadir[:, None])
