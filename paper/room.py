"""The cameras of the paper, and a simulated room (`room.yaml`) with places from which they look."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from localiser.camera import Camera, Mount
from localiser.documents import load, validate
from localiser.geometry import Array, forward, wrap_angle
from localiser.simulate import World, clearance_m, solids_of, world_of

FIELD_OF_VIEW_RAD = np.deg2rad(60.0)
"""Across the image, as in the paper's simulations; it does not say what the real camera had."""
Size = tuple[int, int]
SIZES = ((176, 144), (640, 480))
_CLEAR_M = 0.5
_HALF_M = 1.6  # places are drawn from here
_ASIDE_RAD = np.deg2rad(35.0)  # and look across the room, this far from its middle at most
_HEIGHT_M = 0.8


def camera_of(size: Size, tilt_deg: float) -> Camera:
    """Return an ideal camera of this size (width, height), 60° across, that turns on the spot."""
    width, height = size
    focal = width / 2 / float(np.tan(FIELD_OF_VIEW_RAD / 2))
    mount = Mount(tilt_rad=float(np.deg2rad(tilt_deg)), height_m=_HEIGHT_M)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, mount)


def room() -> World:
    """Return the room."""
    return validate(load(Path(__file__).with_name("room.yaml")), World, world_of)


def draw_places(count: int, drive_m: float, rng: np.random.Generator) -> Array:
    """Return robot poses (count, 3) all over the room, with room to drive ahead by `drive_m`."""
    solids = solids_of(room())
    places: list[Array] = []
    while len(places) < count:
        x, z, aside = rng.uniform([-_HALF_M, -_HALF_M, -_ASIDE_RAD], [_HALF_M, _HALF_M, _ASIDE_RAD])
        pose = np.array([x, z, wrap_angle(np.arctan2(x, z) + aside)])
        ahead = pose[:2] + drive_m * forward(pose[2])
        if clearance_m(solids, np.array([pose[:2], ahead]), _HEIGHT_M).min() > _CLEAR_M:
            places.append(pose)
    return np.array(places)
