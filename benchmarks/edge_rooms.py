"""Rendered rooms full of furniture: counters, tables, sofas, shelves, things that stand on them; one a seed.

Each room has its own camera, from a vacuum cleaner's to one that is held by hand, and places from which it looks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from localiser.geometry import Array
from localiser.simulate import world_of
from localiser.simulate.render import Scene, render, scene_of
from localiser.simulate.solids import clearance_m

Part = dict[str, object]
_TEXTURES = ("plain", "plain", "plaster", "wood", "wallpaper", "carpet")
_WALLS = ("plain", "plaster", "plaster", "wallpaper", "brick")
_FLOORS = ("plain", "planks", "tiles", "carpet")
_FREE_M = 0.35
"""How far from everything the camera stands."""
_TRIES = 200


@dataclass(frozen=True, slots=True, eq=False)
class RoomView:
    """An image (H, W) taken in a room, and the floor pose (3,) of its camera."""

    image: Array
    scene: Scene
    pose: Array


def room_views(seed: int, images: int) -> Iterator[RoomView]:
    """Yield images of one room, from places drawn at random."""
    rng = np.random.default_rng([seed, 0])
    world, size = _room(rng)
    scene = scene_of(world_of(world))
    for pose in _poses(scene, size, images, rng):
        taken = render(scene, pose, rng)
        yield RoomView(taken if taken.ndim == 2 else taken[..., 1].copy(), scene, pose)


def _poses(scene: Scene, size: Array, count: int, rng: np.random.Generator) -> Array:
    """Return poses (P, 3) that are free, at most `count`, facing what is at least a metre away."""
    points = np.column_stack([rng.uniform(-0.5, 0.5, (_TRIES, 2)) * (size - 2 * _FREE_M), np.zeros(_TRIES)])
    heading = np.arctan2(points[:, 0], points[:, 1]) + rng.normal(0, 0.7, _TRIES)  # towards the middle, roughly
    free = clearance_m(scene.structure.solids, points[:, :2], 2.0) > _FREE_M
    return np.column_stack([points[:, :2], heading])[free][:count]


def _room(rng: np.random.Generator) -> tuple[dict[str, object], Array]:
    """Return a world (`localiser-world/1`) and the size (2,) of its room, whose middle is at 0, 0."""
    size = rng.uniform(4.0, 8.0, 2)
    half = size / 2
    corners = [(-half[0], half[1]), (-half[0], -half[1]), (half[0], -half[1]), (half[0], half[1])]
    walls = [_wall(corners[k], corners[(k + 1) % 4], rng) for k in range(4)]
    return {
        "format": "localiser-world/1",
        "name": "room",
        "ceiling_m": float(rng.uniform(2.3, 3.0)),
        "materials": _materials(rng),
        "floor": {"material": "floor", "direction_deg": float(rng.uniform(0, 180))},
        "ceiling": {"material": "ceiling"},
        "light": {
            "ambient": float(rng.uniform(0.5, 0.9)),
            "directional": float(rng.uniform(0.1, 0.5)),
            "from_deg": float(rng.uniform(0, 360)),
            "lamps": [{"x": float(x), "z": float(z), "strength": 0.3} for x, z in rng.uniform(-half, half, (2, 2))],
        },
        "walls": walls,
        "furniture": _furniture(half, rng),
        "camera": _camera(rng),
        "drive": {"path": [{"to": [0.0, 0.0]}, {"to": [0.0, -0.1]}]},
        "image": {"blur_px": float(rng.uniform(0.4, 1.2)), "noise_sigma": float(rng.uniform(0.5, 5.0))},
    }, size


def _camera(rng: np.random.Generator) -> Part:
    """Return a camera 0.2 to 1.6 m above the floor, tilted by 5° to 40°."""
    tilt = float(rng.uniform(5.0, 40.0))
    mount = {"tilt_deg": tilt, "height_m": float(rng.uniform(0.2, 1.6)), "roll_deg": float(rng.normal(0, 2))}
    return {"focal_px": float(rng.uniform(380, 620)), "mount": mount}


def _materials(rng: np.random.Generator) -> dict[str, Part]:
    """Return materials of random grey and texture; `m0` … `m9` are furniture's."""

    def made(textures: tuple[str, ...], low: float, high: float) -> Part:
        grey = rng.uniform(low, high)
        colour = np.clip(grey + rng.normal(0, 15, 3), 10, 250).astype(int).tolist()
        return {"texture": str(rng.choice(textures)), "colour": colour, "contrast": float(rng.uniform(0.1, 0.7))}

    named = {
        "wall": made(_WALLS, 120, 240),
        "floor": made(_FLOORS, 50, 220),
        "ceiling": made(("plain",), 200, 245),
        "frame": made(("plain", "wood"), 60, 240),
        "door": made(("plain", "wood"), 60, 240),
        "picture": made(("picture",), 60, 230),
    }
    return named | {f"m{k}": made(_TEXTURES, 30, 240) for k in range(10)}


def _wall(start: tuple[float, float], end: tuple[float, float], rng: np.random.Generator) -> Part:
    """Return a wall with at most a door, and with windows or pictures, on its inner side."""
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    wall: Part = {"from": list(map(float, start)), "to": list(map(float, end))}
    if rng.random() < 0.5:
        leaf = {"angle_deg": float(rng.uniform(60, 110)), "side": "right"} if rng.random() < 0.3 else {}
        frame = float(rng.choice([0.0, 0.07]))
        wall["doors"] = [{"at_m": float(rng.uniform(0.2, 0.8)) * length, "leaf": leaf, "frame_m": frame}]
    pictures = []
    for at in rng.uniform(0.1, 0.9, rng.integers(0, 4)):
        bottom = float(rng.uniform(0.3, 1.5))
        size = {
            "width_m": float(rng.uniform(0.3, 1.2)),
            "bottom_m": bottom,
            "top_m": bottom + float(rng.uniform(0.3, 0.9)),
        }
        pictures.append({"at_m": float(at) * length, "side": "right", "material": "picture", **size})
    return wall | {"posters": pictures}


class _Block:
    """Where a piece of furniture stands: its middle, turned; parts are given along and across it, in metres."""

    def __init__(self, x: float, z: float, turn_deg: float, rng: np.random.Generator) -> None:
        self.x, self.z, self.turn_deg, self.rng = x, z, turn_deg, rng
        self.parts: list[Part] = []

    def box(
        self, at: tuple[float, float], size: tuple[float, float], heights: tuple[float, float], material: str
    ) -> None:
        """Add an upright block; at: along and across, to its middle. size: along and across. heights: bottom, top."""
        angle = np.deg2rad(self.turn_deg)
        x = self.x + at[0] * np.cos(angle) + at[1] * np.sin(angle)
        z = self.z - at[0] * np.sin(angle) + at[1] * np.cos(angle)
        block = {"x": float(x), "z": float(z), "width_m": float(size[0]), "depth_m": float(size[1])}
        span = {"bottom_m": float(max(heights[0], 0.0)), "top_m": float(heights[1])}
        self.parts.append(block | span | {"rotation_deg": float(self.turn_deg), "material": material})

    def things(self, size: tuple[float, float], middle_m: float, on_m: float, most: int) -> None:
        """Stand up to `most` things on a level of this size, `middle_m` across: jars, screens, lamps, appliances."""
        for _ in range(self.rng.integers(0, most + 1)):
            width, depth = self.rng.uniform(0.05, 0.45), self.rng.uniform(0.05, 0.3)
            along = self.rng.uniform(-0.5, 0.5) * max(size[0] - width, 0.0)
            across = middle_m + self.rng.uniform(-0.5, 0.5) * max(size[1] - depth, 0.0)
            top = on_m + self.rng.uniform(0.12, 0.55)
            self.box((along, across), (width, depth), (on_m, top), self.any())

    def any(self) -> str:
        """Return a material of furniture."""
        return f"m{self.rng.integers(10)}"


def _furniture(half: Array, rng: np.random.Generator) -> list[Part]:
    """Return furniture along the walls and within the room; two pieces may run into each other, as in real rooms."""
    against = (_counter, _sofa, _shelf, _cabinet, _radiator, _cabinet)
    inside = (_table, _table, _crate, _chair, _sofa)
    parts: list[Part] = []
    for side in range(4):
        turn = (0.0, 90.0, 180.0, 270.0)[side]
        wall_m, length = (half[1], half[0]) if side % 2 == 0 else (half[0], half[1])
        for place in np.linspace(-0.65, 0.65, 3):
            if rng.random() < 0.7:
                # Across points away from the wall: towards +z at turn 0, whose wall is at -z.
                angle = np.deg2rad(turn)
                along, across = place * length, -wall_m + 0.06
                x, z = along * np.cos(angle) + across * np.sin(angle), -along * np.sin(angle) + across * np.cos(angle)
                block = _Block(float(x), float(z), turn, rng)
                against[rng.integers(len(against))](block)
                parts += block.parts
    for _ in range(rng.integers(1, 5)):
        x, z = rng.uniform(-0.6, 0.6, 2) * half
        block = _Block(float(x), float(z), float(rng.uniform(0, 360)), rng)
        inside[rng.integers(len(inside))](block)
        parts += block.parts
    return parts


def _counter(block: _Block) -> None:
    """Cupboards over a plinth that is set back, under a worktop, with things on it; some with cupboards above."""
    rng = block.rng
    length, depth, high = rng.uniform(0.8, 2.2), rng.uniform(0.5, 0.65), rng.uniform(0.8, 1.0)
    front, body = block.any(), block.any()
    block.box((0, depth / 2 - 0.03), (length, depth - 0.06), (0, 0.1), body)
    doors = max(int(length / 0.6), 1)
    for k in range(doors):
        width = length / doors
        at = (-length / 2 + (k + 0.5) * width, depth / 2)
        block.box(at, (width - 0.006, depth), (0.1, high - 0.04), front)
    block.box((0, depth / 2 + 0.01), (length + 0.02, depth + 0.02), (high - 0.04, high), block.any())
    block.things((length, depth), depth / 2, high, 6)
    if rng.random() < 0.4:
        block.box((0, 0.18), (length * 0.8, 0.35), (1.45, 2.1), front)


def _table(block: _Block) -> None:
    """A table on four legs or two panels, with things on it and a chair."""
    rng = block.rng
    length, depth, high = rng.uniform(0.8, 1.8), rng.uniform(0.5, 0.9), rng.choice([0.42, 0.74])
    wood = block.any()
    block.box((0, 0), (length, depth), (high - 0.035, high), wood)
    if rng.random() < 0.7:
        thick = rng.uniform(0.04, 0.08)
        for a in (-1, 1):
            for b in (-1, 1):
                at = (a * (length / 2 - thick), b * (depth / 2 - thick))
                block.box(at, (thick, thick), (0, high - 0.035), wood)
    else:
        for a in (-1, 1):
            block.box((a * (length / 2 - 0.05), 0), (0.03, depth * 0.9), (0, high - 0.035), wood)
    block.things((length, depth), 0.0, high, 5)


def _chair(block: _Block) -> None:
    seat, high, wood = block.rng.uniform(0.38, 0.5), 0.45, block.any()
    for a in (-1, 1):
        for b in (-1, 1):
            block.box((a * (seat / 2 - 0.02), b * (seat / 2 - 0.02)), (0.035, 0.035), (0, high - 0.04), wood)
    block.box((0, 0), (seat, seat), (high - 0.04, high), block.any())
    block.box((0, -seat / 2 + 0.02), (seat, 0.03), (high + 0.05, 0.9), wood)


def _sofa(block: _Block) -> None:
    """A seat, arms and a back, with cushions."""
    rng = block.rng
    length, depth, seat = rng.uniform(0.8, 2.2), rng.uniform(0.75, 0.95), rng.uniform(0.36, 0.46)
    cloth, foot = block.any(), float(rng.choice([0.0, 0.06, 0.12]))
    block.box((0, depth / 2), (length, depth), (foot, seat), cloth)
    if foot:
        for a in (-1, 1):
            for b in (0.1, depth - 0.1):
                block.box((a * (length / 2 - 0.08), b), (0.05, 0.05), (0, foot), block.any())
    block.box((0, 0.1), (length, 0.2), (seat, rng.uniform(0.7, 0.95)), cloth)
    for a in (-1, 1):
        block.box((a * (length / 2 + 0.08), depth / 2), (0.16, depth), (foot, rng.uniform(0.5, 0.65)), cloth)
    for along in rng.uniform(-0.4, 0.4, rng.integers(0, 4)):
        block.box((along * length, 0.32), (0.4, 0.15), (seat, seat + rng.uniform(0.25, 0.45)), block.any())


def _shelf(block: _Block) -> None:
    """A shelf with boards and rows of books."""
    rng = block.rng
    length, depth, high, wood = rng.uniform(0.6, 1.4), rng.uniform(0.25, 0.4), rng.uniform(0.9, 2.1), block.any()
    for a in (-1, 1):
        block.box((a * length / 2, depth / 2), (0.025, depth), (0, high), wood)
    block.box((0, 0.01), (length, 0.02), (0, high), block.any())
    for level in np.arange(0.06, high, rng.uniform(0.28, 0.4)):
        block.box((0, depth / 2), (length, depth), (level, level + 0.025), wood)
        along = -length / 2 + 0.02
        while along < length / 2 - 0.1 and rng.random() < 0.85:
            width = rng.uniform(0.02, 0.15)
            if rng.random() < 0.8:
                tall = rng.uniform(0.12, 0.25)
                block.box(
                    (along + width / 2, depth * 0.45),
                    (width, depth * 0.7),
                    (level + 0.025, level + 0.025 + tall),
                    block.any(),
                )
            along += width + 0.003


def _cabinet(block: _Block) -> None:
    """A cabinet or sideboard, with things on it if it is low."""
    rng = block.rng
    length, depth, high = rng.uniform(0.4, 1.6), rng.uniform(0.3, 0.6), rng.choice([0.5, 0.75, 1.1, 1.9])
    foot = float(rng.choice([0.0, 0.0, 0.08]))
    block.box((0, depth / 2), (length, depth), (foot, high), block.any())
    if foot:
        block.box((0, depth / 2 - 0.03), (length - 0.06, depth - 0.06), (0, foot), block.any())
    block.things((length, depth * 0.6), depth / 2, high, 3)


def _radiator(block: _Block) -> None:
    block.box((0, 0.08), (block.rng.uniform(0.5, 1.4), 0.08), (0.12, block.rng.uniform(0.5, 0.75)), block.any())


def _crate(block: _Block) -> None:
    rng = block.rng
    size = rng.uniform(0.25, 0.6, 3)
    block.box((0, 0), (size[0], size[1]), (0, size[2]), block.any())
    if rng.random() < 0.5:
        block.box((0, 0), (size[0] * 0.6, size[1] * 0.6), (size[2], size[2] + rng.uniform(0.15, 0.4)), block.any())
