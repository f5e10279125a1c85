"""The image as an ideal pinhole camera would have taken it, so that straight edges are straight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera, RollingShutter
from localiser.geometry import Array

Image = NDArray[np.uint8]

NEGLIGIBLE_BEND_PX = 0.1
"""A line detector cannot tell a line that bends by less than this from a straight one."""
_GRID_PX = 8
"""Spacing of the grid on which lens models are computed; between, a cubic is off by less than tables round off."""
_LARGEST_GROWTH = 2.0
"""Limit of the ideal image's size over the taken one's; a wide lens sees what no sensible flat image can hold."""
_MARGIN_PX = 3
"""Pixels of the ideal image that are closer than this to one without content are not used."""


@dataclass(frozen=True, slots=True, eq=False)
class IdealView:
    """A remap of the taken image into an ideal one that holds the whole field of view.

    camera: the pinhole camera of the ideal image. map_1, map_2: tables of `cv2.remap`. seen: (H, W) uint8, 0 where
    the taken image has nothing to show, or within 3 px of there.
    """

    camera: Camera
    map_1: NDArray[np.int16]
    map_2: NDArray[np.uint16]
    seen: Image

    def of(self, image: Image) -> Image:
        """Return the ideal image of a taken one (H, W)."""
        return np.asarray(cv2.remap(image, self.map_1, self.map_2, cv2.INTER_LINEAR), dtype=np.uint8)


@lru_cache(maxsize=8)
def ideal_camera(camera: Camera) -> Camera:
    """Return the cached ideal pinhole camera with the same matrix and mount."""
    return camera.undistorted()


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
    even = grey[: 2 * height, : 2 * width]
    return np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA))


def bend_px(camera: Camera) -> float:
    """Return by how many pixels the lens bends a straight line across the image at most.

    Measured on the image border and the middle lines, as the largest distance from the chord.
    """
    if not camera.is_distorted:
        return 0.0
    top, bottom, left, right = camera.border_px(33)
    lines = np.array([top, (top + bottom) / 2, bottom, left, (left + right) / 2, right])
    straight = camera.undistorted().pixels_from_image(camera.image_from_pixels(lines))
    chord = straight[:, -1] - straight[:, 0]
    offset = straight - straight[:, :1]
    across = offset[..., 0] * chord[:, None, 1] - offset[..., 1] * chord[:, None, 0]
    return float(np.max(np.abs(across) / np.linalg.norm(chord, axis=1)[:, None]))


@lru_cache(maxsize=8)
def ideal_view(camera: Camera) -> IdealView | None:
    """Return the cached remap that undoes the lens distortion of `camera`, or None where that is negligible."""
    if bend_px(camera) < NEGLIGIBLE_BEND_PX:
        return None
    left, top, width, height = _ideal_extent(camera)
    ideal = replace(camera.undistorted(), width=width, height=height, cx=camera.cx - left, cy=camera.cy - top)
    map_1, map_2, unseen = remap_tables(ideal.image_from_pixels, (width, height), camera)
    around = np.ones((2 * _MARGIN_PX + 1, 2 * _MARGIN_PX + 1), np.uint8)
    shown = (~unseen).astype(np.uint8)
    seen = np.asarray(cv2.erode(shown, around, borderType=cv2.BORDER_CONSTANT, borderValue=0), dtype=np.uint8)
    return IdealView(ideal, map_1, map_2, seen)


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
    u, v, radius = (
        (of_rows @ values @ of_columns.T).astype(np.float32) for values in (*np.moveaxis(taken, -1, 0), radius)
    )
    shown = (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1) & (radius <= _furthest(camera))
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


def _furthest(camera: Camera) -> float:
    """Return the largest distance from the image's centre at which something can be seen, in image coordinates.

    Far outside the field of view a distortion polynomial turns back and would show the image's inside once more; the
    corners of the image bound what it was fitted for.
    """
    return (
        float(np.linalg.norm(camera.image_from_pixels(camera.border_px().reshape(-1, 2)), axis=-1).max())
        + 1 / camera.focal_px
    )


def _ideal_extent(camera: Camera) -> tuple[int, int, int, int]:
    """Return (left, top, width, height) px of the ideal image that holds the border of the taken one."""
    ideal = camera.undistorted().pixels_from_image(camera.image_from_pixels(camera.border_px().reshape(-1, 2)))
    size = np.array([camera.width, camera.height])
    slack = (_LARGEST_GROWTH - 1) / 2 * size
    low = np.floor(np.maximum(ideal.min(axis=0), -slack)).astype(int)
    high = np.ceil(np.minimum(ideal.max(axis=0), size - 1 + slack)).astype(int)
    width, height = high - low + 1
    return int(low[0]), int(low[1]), int(width), int(height)
