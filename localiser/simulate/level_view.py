"""The level view: what an untilted camera at the same place would see, and the look-up that tilts it.

Tilt, roll and lens turn rays about the camera's centre only, so one look-up makes the real image out of the level
view, in which every vertical edge is a column (design equation 3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.geometry import Array

OVERSAMPLE = 2  # samples along each axis, of the level view and of the final image, for one pixel of that image
SMALLEST_DEPTH = 0.2  # rays steeper down (or up) than 78° would need a level view without end


@dataclass(frozen=True, slots=True, eq=False)
class LevelView:
    """The level view's pixels, C columns of R rows, and where the camera's image finds its samples in them.

    Column i holds tan(bearing) from left + i / per_unit to left + (i + 1) / per_unit. Row j samples the elevation
    tangent top - (j + 1/2) / per_unit. first_row, stop_row: (C,) rows that the image needs. row_at, column_at:
    (H', W') of each sample of the image. size: (W, H) of the image.
    """

    left: float
    top: float
    per_unit: float
    columns: int
    rows: int
    first_row: NDArray[np.intp]
    stop_row: NDArray[np.intp]
    row_at: NDArray[np.float32]
    column_at: NDArray[np.float32]
    size: tuple[int, int]

    def elevation_of_rows(self, rows: NDArray[np.intp]) -> NDArray[np.float32]:
        """Return the elevation tangents sampled by these rows."""
        return (self.top - (rows + 0.5) / self.per_unit).astype(np.float32)

    def rows_below(self, elevation: Array) -> NDArray[np.intp]:
        """Return the first rows that sample below these elevation tangents."""
        return np.ceil((self.top - elevation) * self.per_unit - 0.5).astype(np.intp)

    def image(self, view: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the camera's image (H, W, 3) of the level view (C, R, 3)."""
        fine = cv2.remap(view, self.row_at, self.column_at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(cv2.resize(fine, self.size, interpolation=cv2.INTER_AREA))


def require_view_ahead(camera: Camera) -> None:
    """Raise ValueError when the image looks straight down somewhere; its border then does, or looks behind."""
    rays = camera.level_rays(camera.border_px(outside_px=0.5))
    if not (-rays[..., 2] / np.linalg.norm(rays, axis=-1)).min() > SMALLEST_DEPTH:
        raise ValueError("the image must not look straight down: expected a smaller tilt or a narrower field of view")


@lru_cache(maxsize=1)
def level_view_of(camera: Camera) -> LevelView:
    """Return the level view that covers the camera's image, which must not look straight down."""
    return _view_of_rays(_rays(camera), camera)


def strip_view_of(camera: Camera, rows: slice, turned_rad: Array) -> LevelView:
    """Return the level view that covers some rows (R,) of the camera's image, each taken with the camera turned on.

    turned_rad: (R,) anticlockwise, about the vertical through the camera.
    """
    rays = _rays(camera)[rows.start * OVERSAMPLE : rows.stop * OVERSAMPLE]
    turned = np.repeat(turned_rad, OVERSAMPLE)[:, None]
    x, z = rays[..., 0], rays[..., 2]
    cos, sin = np.cos(turned), np.sin(turned)
    return _view_of_rays(np.stack([cos * x + sin * z, rays[..., 1], -sin * x + cos * z], axis=-1), camera)


@lru_cache(maxsize=1)
def _rays(camera: Camera) -> Array:
    """Return rays (H', W', 3) of the level frame through all samples of the camera's image."""
    u = (np.arange(camera.width * OVERSAMPLE) + 0.5) / OVERSAMPLE - 0.5
    v = (np.arange(camera.height * OVERSAMPLE) + 0.5) / OVERSAMPLE - 0.5
    return camera.level_rays(np.stack(np.meshgrid(u, v), axis=-1))


def _view_of_rays(rays: Array, camera: Camera) -> LevelView:
    """Return the level view that covers rays (H', W', 3) of some rows of the camera's image."""
    bearing, elevation = rays[..., 0] / -rays[..., 2], rays[..., 1] / -rays[..., 2]
    per_unit = OVERSAMPLE * camera.focal_px
    margin = 3 / per_unit
    left, top = float(bearing.min() - margin), float(elevation.max() + margin)
    columns = int(np.ceil((bearing.max() + margin - left) * per_unit))
    rows = int(np.ceil((top - elevation.min() + margin) * per_unit))
    column_at, row_at = (bearing - left) * per_unit - 0.5, (top - elevation) * per_unit - 0.5
    first_row, stop_row = _needed_rows(column_at, row_at, columns, rows)
    return LevelView(
        left,
        top,
        per_unit,
        columns,
        rows,
        first_row,
        stop_row,
        row_at.astype(np.float32),
        column_at.astype(np.float32),
        (camera.width, len(rays) // OVERSAMPLE),
    )


def _needed_rows(column_at: Array, row_at: Array, columns: int, rows: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return for each column the rows that interpolation touches, with two columns and rows to spare."""
    first, last = np.full(columns, rows), np.full(columns, -1)
    column = np.floor(column_at).astype(np.intp).ravel()
    row = np.floor(row_at).astype(np.intp).ravel()
    np.minimum.at(first, column, row)
    np.maximum.at(last, column, row)
    reach = range(-2, 4)
    first = np.min([np.roll(first, k) for k in reach], axis=0)
    last = np.max([np.roll(last, k) for k in reach], axis=0)
    first, stop = np.clip(first - 2, 0, rows), np.clip(last + 4, 0, rows)
    return first, np.maximum(stop, first)
