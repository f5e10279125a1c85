"""The room in which the paper's motions are made: door openings, pillars, a cupboard, boards on the floor."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from localiser.camera import Camera, Mount
from localiser.geometry import Array, forward, wrap_angle
from localiser.simulate import Solids, World, clearance_m, structure_of, world_of

FIELD_OF_VIEW_RAD = np.deg2rad(60.0)
"""Across the image, as in the paper's simulations; it does not say what the real camera had."""
SIZES = ((176, 144), (640, 480))
_CLEAR_M = 0.5
_HALF_M = 1.6  # places are drawn from here
_ASIDE_RAD = np.deg2rad(35.0)  # and look across the room, this far from its middle at most
_HEIGHT_M = 0.8


def camera_of(size: tuple[int, int], tilt_deg: float) -> Camera:
    """Return an ideal camera of this size (width, height), 60° across, that turns on the spot."""
    width, height = size
    focal = width / 2 / float(np.tan(FIELD_OF_VIEW_RAD / 2))
    mount = Mount(tilt_rad=float(np.deg2rad(tilt_deg)), height_m=_HEIGHT_M)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, mount)


def draw_places(count: int, drive_m: float, rng: np.random.Generator) -> Array:
    """Return robot poses (count, 3) all over the room, with room to drive ahead by `drive_m`."""
    solids = _solids()
    places: list[Array] = []
    while len(places) < count:
        x, z, aside = rng.uniform([-_HALF_M, -_HALF_M, -_ASIDE_RAD], [_HALF_M, _HALF_M, _ASIDE_RAD])
        pose = np.array([x, z, wrap_angle(np.arctan2(x, z) + aside)])
        ahead = pose[:2] + drive_m * forward(pose[2])
        if clearance_m(solids, np.array([pose[:2], ahead]), _HEIGHT_M).min() > _CLEAR_M:
            places.append(pose)
    return np.array(places)


@lru_cache(maxsize=1)
def _solids() -> Solids:
    return structure_of(room()).solids


def room() -> World:
    """Return the room. Noise and blur are those of a cheap web camera."""
    plain = {"texture": "plain", "contrast": 0.0}
    return world_of(
        {
            "format": "localiser-world/1",
            "name": "room",
            "ceiling_m": 2.6,
            "materials": {
                "wall": {"texture": "plaster", "colour": [196, 192, 182], "contrast": 0.3},
                "far": {**plain, "colour": [120, 126, 132]},
                "dark": {**plain, "colour": [66, 72, 84]},
                "red": {**plain, "colour": [150, 70, 60]},
                "wood": {"texture": "wood", "colour": [150, 112, 76], "contrast": 0.3},
                "floor": {"texture": "tiles", "colour": [150, 144, 134], "size_m": 0.5, "contrast": 0.4},
                "ceiling": {**plain, "colour": [214, 214, 210]},
            },
            "floor": {"material": "floor"},
            "ceiling": {"material": "ceiling"},
            "walls": [*_shell(3.4, "wall", doors=True), *_shell(5.2, "far", doors=False)],
            "posts": _posts(),
            "furniture": [
                {"x": 3.0, "z": 1.9, "width_m": 0.5, "depth_m": 1.0, "top_m": 1.9, "material": "wood"},
                {"x": -3.05, "z": -2.2, "width_m": 0.5, "depth_m": 1.3, "top_m": 0.9, "material": "red"},
                {"x": -0.6, "z": 3.1, "width_m": 0.9, "depth_m": 0.4, "top_m": 1.7, "material": "wood"},
            ],
            "camera": {"focal_px": 554.0, "mount": {"tilt_deg": 20.0, "height_m": _HEIGHT_M}},
            "drive": {"path": [{"to": [0.0, 1.5]}, {"to": [0.0, 1.0]}]},
            "image": {"noise_sigma": 3.0, "blur_px": 0.6, "colour": False},
        }
    )


def _posts() -> list[dict[str, object]]:
    """Return pillars along the walls, and one in the room."""
    at = np.array([-2.9, -1.9, -0.9, 0.3, 1.3, 2.3])
    names = ("dark", "red", "far")
    along = [(x, -3.15) for x in at] + [(-3.15, z) for z in at[1:]] + [(x, 3.2) for x in at[2:]] + [(3.2, -0.4)]
    pillars = [
        {"x": float(x), "z": float(z), "width_m": 0.2 + 0.05 * (k % 3), "rotation_deg": 15.0 * (k % 4),
         "material": names[k % 3]}
        for k, (x, z) in enumerate(along)
    ]  # fmt: skip
    return [*pillars, {"x": 0.1, "z": 0.2, "width_m": 0.3, "top_m": 1.4, "material": "dark"}]


def _shell(half_m: float, material: str, *, doors: bool) -> list[dict[str, object]]:
    """Return four walls around the middle; seen through their doors, others stand behind them."""
    corners = [[-half_m, half_m], [-half_m, -half_m], [half_m, -half_m], [half_m, half_m]]
    openings = [[1.6, 5.0], [3.0], [2.0, 5.4], [4.2]]
    return [
        {
            "from": corners[side],
            "to": corners[(side + 1) % 4],
            "material": material,
            "doors": [{"at_m": at, "frame_m": 0.0, "frame_material": material} for at in openings[side]]
            if doors
            else [],
        }
        for side in range(4)
    ]
