"""How bright surfaces are: even light, a main direction, lamps, and floors that darken towards walls and furniture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.errors import InputError
from localiser.geometry import Array
from localiser.simulate.solids import Solids
from localiser.simulate.textures import look_up
from localiser.simulate.world import Light

_CELL_M = 0.04
_SHADOW_M = 0.16  # how far a solid darkens the floor around it
_SHADOW = 0.75  # share of the light that it takes away right at its foot, from both sides together
_UNDERSIDE = 0.6
_MARGIN_M = 0.5
MOST_FLOOR_M2 = 20_000  # around all that is in the world


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """Light of one world. floor: (H, W) brightness of cells of the floor, origin: (2,) x, z of its first cell."""

    light: Light
    floor: NDArray[np.float32]
    origin: Array

    def of_floor(self, x: NDArray[np.float32], z: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the brightness of floor points (S,)."""
        x_cell, z_cell = (
            np.float32(1 / _CELL_M) * (value - np.float32(o)) for value, o in zip((x, z), self.origin, strict=True)
        )
        return look_up(self.floor, x_cell, z_cell)

    def of_faces(self, points: Array, normals: Array) -> Array:
        """Return the brightness of upright faces at points (S, 2) with outward normals (S, 2)."""
        towards = normals @ geometry.forward(np.deg2rad(self.light.from_deg))
        return _lamps(self.light, points) * (1.0 + self.light.directional * towards)

    def of_tops(self, points: Array, is_underside: NDArray[np.bool_]) -> Array:
        """Return the brightness of tops and undersides at points (S, 2)."""
        return _lamps(self.light, points) * np.where(is_underside, _UNDERSIDE, 1.1)


def lighting_of(light: Light, solids: Solids, path: Array) -> Lighting:
    """Return the light of a world of solids; path: (T, 2) points that the floor must reach as well.

    Raises InputError for a floor that is too large to be drawn.
    """
    points = np.concatenate([solids.corners.reshape(-1, 2), path])
    origin = points.min(axis=0) - _MARGIN_M
    extent = points.max(axis=0) + _MARGIN_M - origin
    if extent.prod() > MOST_FLOOR_M2:
        problem = (
            f"expected a floor of at most {MOST_FLOOR_M2} m² to be drawn, found {extent[0]:.0f} m × {extent[1]:.0f} m"
        )
        raise InputError(problem, field="walls")
    width, height = np.ceil(extent / _CELL_M).astype(int) + 1
    covered = np.zeros((height, width), dtype=np.float32)
    for corners in solids.corners[(solids.bottom_m < 0.3) & ~solids.is_flat]:
        fine = np.round((corners - origin) / _CELL_M * 16).astype(np.int32)
        cv2.fillConvexPoly(covered, fine, 1.0, cv2.LINE_AA, shift=4)
    shadow = cv2.GaussianBlur(covered, (0, 0), _SHADOW_M / _CELL_M)
    x, z = np.meshgrid(np.arange(width) * _CELL_M + origin[0], np.arange(height) * _CELL_M + origin[1])
    lamps = _lamps(light, np.stack([x, z], axis=-1))
    return Lighting(light, (lamps * (1 - _SHADOW * shadow)).astype(np.float32), origin)


def _lamps(light: Light, points: Array) -> Array:
    """Return ambient light plus that of lamps, which falls off with the square of the distance, at points (..., 2)."""
    bright = np.full(points.shape[:-1], light.ambient)
    for lamp in light.lamps:
        distance_squared = ((points - [lamp.x, lamp.z]) ** 2).sum(axis=-1)
        bright += lamp.strength / (1 + distance_squared / lamp.height_m**2)
    return bright
