"""The image as an ideal pinhole camera would have taken it, so that straight edges are straight."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.geometry import Array

Image = NDArray[np.uint8]

NEGLIGIBLE_BEND_PX = 0.1
"""A line detector cannot tell a line that bends by less than this from a straight one."""
_LARGEST_GROWTH = 2.0
"""Limit of the ideal image's size over the taken one's; a wide lens sees what no sensible flat image can hold."""


@dataclass(frozen=True, slots=True, eq=False)
class IdealView:
    """A remap of the taken image into an ideal one that holds the whole field of view.

    camera: the pinhole camera of the ideal image. map_1, map_2: tables of `cv2.remap`. seen: (H, W) uint8, 0 where
    the taken image has nothing to show, or within `margin_px` of there.
    """

    camera: Camera
    map_1: NDArray[np.int16]
    map_2: NDArray[np.uint16]
    seen: Image

    def of(self, image: Image) -> Image:
        """Return the ideal image of a taken one (H, W)."""
        return np.asarray(cv2.remap(image, self.map_1, self.map_2, cv2.INTER_LINEAR), dtype=np.uint8)


def bend_px(camera: Camera) -> float:
    """Return by how many pixels the lens bends a straight line across the image at most.

    Measured on the image border and the middle lines, as the largest distance from the chord.
    """
    if not camera.is_distorted:
        return 0.0
    steps = np.linspace(0.0, 1.0, 33)
    u, v = steps * (camera.width - 1), steps * (camera.height - 1)
    lines = [np.stack([u, np.full_like(u, row)], axis=-1) for row in (v[0], v[16], v[-1])]
    lines += [np.stack([np.full_like(v, column), v], axis=-1) for column in (u[0], u[16], u[-1])]
    straight = camera.undistorted().pixels_from_image(camera.image_from_pixels(np.array(lines)))
    chord = straight[:, -1] - straight[:, 0]
    offset = straight - straight[:, :1]
    across = offset[..., 0] * chord[:, None, 1] - offset[..., 1] * chord[:, None, 0]
    return float(np.max(np.abs(across) / np.linalg.norm(chord, axis=1)[:, None]))


@lru_cache(maxsize=8)
def ideal_view(camera: Camera, margin_px: int = 3) -> IdealView | None:
    """Return the cached remap that undoes the lens distortion of `camera`, or None where that is negligible."""
    if bend_px(camera) < NEGLIGIBLE_BEND_PX:
        return None
    left, top, width, height = _ideal_extent(camera)
    ideal = replace(camera.undistorted(), width=width, height=height, cx=camera.cx - left, cy=camera.cy - top)
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    image_points = ideal.image_from_pixels(np.stack([columns, rows], axis=-1))
    taken = camera.pixels_from_image(image_points)
    shown = is_shown(image_points, taken, camera).astype(np.uint8)
    around = np.ones((2 * margin_px + 1, 2 * margin_px + 1), np.uint8)
    seen = np.asarray(cv2.erode(shown, around, borderType=cv2.BORDER_CONSTANT, borderValue=0), dtype=np.uint8)
    taken_u, taken_v = np.moveaxis(taken.astype(np.float32), -1, 0).copy()
    map_1, map_2 = cv2.convertMaps(taken_u, taken_v, cv2.CV_16SC2)
    return IdealView(ideal, np.asarray(map_1), np.asarray(map_2), seen)


def is_shown(image_points: Array, taken_px: Array, camera: Camera) -> NDArray[np.bool_]:
    """Return (...) whether image coordinates (..., 2), which project to pixels (..., 2), are in the taken image.

    Far outside the field of view a distortion polynomial turns back and would show the image's inside once more; the
    corners of the image bound what it was fitted for.
    """
    inside = np.all((taken_px >= 0) & (taken_px <= [camera.width - 1, camera.height - 1]), axis=-1)
    furthest = np.linalg.norm(camera.image_from_pixels(image_border(camera)), axis=-1).max()
    return np.asarray(inside & (np.linalg.norm(image_points, axis=-1) <= furthest + 1 / camera.focal_px))


def image_border(camera: Camera) -> Array:
    """Return pixels (P, 2) along the border of the taken image."""
    u, v = np.linspace(0, camera.width - 1, 65), np.linspace(0, camera.height - 1, 65)
    rows = [np.stack([u, np.full_like(u, row)], axis=-1) for row in (0.0, camera.height - 1.0)]
    columns = [np.stack([np.full_like(v, column), v], axis=-1) for column in (0.0, camera.width - 1.0)]
    return np.concatenate(rows + columns)


def _ideal_extent(camera: Camera) -> tuple[int, int, int, int]:
    """Return (left, top, width, height) px of the ideal image that holds the border of the taken one."""
    ideal = camera.undistorted().pixels_from_image(camera.image_from_pixels(image_border(camera)))
    size = np.array([camera.width, camera.height])
    slack = (_LARGEST_GROWTH - 1) / 2 * size
    low = np.floor(np.maximum(ideal.min(axis=0), -slack)).astype(int)
    high = np.ceil(np.minimum(ideal.max(axis=0), size - 1 + slack)).astype(int)
    width, height = high - low + 1
    return int(low[0]), int(low[1]), int(width), int(height)
