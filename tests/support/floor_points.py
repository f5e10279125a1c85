"""Points of the floor that a camera sees."""

import numpy as np
from numpy.typing import ArrayLike

from localiser.camera import Camera
from localiser.geometry import Array


def floor_points(camera: Camera, pixels: ArrayLike) -> Array:
    """Return floor points (x, z) (..., 2) of the level frame seen at pixels (..., 2); nan above the horizon."""
    rays = camera.level_rays(pixels)
    down = np.where(rays[..., 1] < 0, -rays[..., 1], np.nan)
    return np.asarray(rays[..., [0, 2]] * (camera.mount.height_m / down)[..., None])
