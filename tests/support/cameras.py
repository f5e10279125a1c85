"""The camera of many tests, and the floor that a camera sees."""

import numpy as np
from numpy.typing import ArrayLike

from localiser.camera import Camera, Mount
from localiser.geometry import Array


def vga_camera(mount: Mount, lens: str = "none", distortion: tuple[float, ...] = ()) -> Camera:
    """Return a camera of 640 × 480 pixels, focal length 554 px, principal point in the middle."""
    return Camera(640, 480, 554.0, 554.0, 319.5, 239.5, mount, lens, distortion)


def floor_points(camera: Camera, pixels: ArrayLike) -> Array:
    """Return floor points (x, z) (..., 2) of the level frame seen at pixels (..., 2); nan above the horizon."""
    rays = camera.level_rays(pixels)
    down = np.where(rays[..., 1] < 0, -rays[..., 1], np.nan)
    return np.asarray(rays[..., [0, 2]] * (camera.mount.height_m / down)[..., None])
