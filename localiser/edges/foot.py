"""The foot of an edge: where it meets the floor, if its lower end stands there."""

from __future__ import annotations

import numpy as np

from localiser import geometry
from localiser.camera import Camera
from localiser.geometry import Array

FOOT_SIGMA_PX = 2.0
"""Error of an edge's lower end along the edge: where a line stops is far less certain than where it runs."""
BORDER_PX = 4.0 * FOOT_SIGMA_PX
"""An edge that is found to end this close to the image border may as well be cut off by it."""


def foot_of_edges(bottom_px: Array, camera: Camera, taken_px: Array | None = None) -> tuple[Array, Array]:
    """Return the floor range (E,) m of feet seen at pixels (E, 2), and its sigma; nan where no foot is seen.

    A foot is where an edge ends inside the image and below the horizon. Design equation 9. taken_px: (E, 2) where the
    image shows them, if a rolling shutter took them elsewhere.
    """
    size, taken_px = np.array([camera.width, camera.height]), bottom_px if taken_px is None else taken_px
    inside = np.all((taken_px >= BORDER_PX) & (taken_px <= size - 1 - BORDER_PX), axis=1)
    rays = camera.level_rays(bottom_px)
    depression = np.arctan2(-rays[:, 1], np.hypot(rays[:, 0], rays[:, 2]))
    sigma_rad = FOOT_SIGMA_PX / camera.focal_px
    seen = inside & (depression > sigma_rad)
    range_m = geometry.floor_range(camera.mount.height_m, np.where(seen, depression, np.nan))
    return range_m, geometry.floor_range_sigma(camera.mount.height_m, range_m, sigma_rad)
