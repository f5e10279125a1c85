"""The building as upright prisms: wall, lintel, frame, leaf, post and box are convex footprints between heights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.geometry import Array
from localiser.simulate.world import Box, Door, Leaf, Post, Wall, World

POSTER_DEPTH_M = 0.002


@dataclass(frozen=True, slots=True, eq=False)
class Solids:
    """Upright prisms, P of them, with up to K corners.

    corners: (P, K, 2) x, z, anticlockwise seen from above; short footprints repeat their last corner. bottom_m, top_m:
    (P,). material: P names. along_m: (P,) where the texture of a face starts, above_m: (P,) and at which height.
    is_flat: (P,) bool, a picture: seen but no landmark.
    """

    corners: Array
    bottom_m: Array
    top_m: Array
    material: tuple[str, ...]
    along_m: Array
    above_m: Array
    is_flat: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.bottom_m)

    def half_planes(self) -> tuple[Array, Array]:
        """Return outward normals (P, K, 2), unit or 0, and offsets (P, K): inside is normal · point <= offset.

        The side k leads from corner k to corner k + 1.
        """
        side = np.roll(self.corners, -1, axis=1) - self.corners
        length = np.linalg.norm(side, axis=-1, keepdims=True)
        # Anticlockwise seen from above, with x to the right and z down the page, has its outside at (-dz, dx).
        outward = np.stack([-side[..., 1], side[..., 0]], axis=-1)
        normals = np.divide(outward, length, out=np.zeros_like(outward), where=length > 1e-9)
        offsets = (normals * self.corners).sum(axis=-1)
        return normals, np.where(length[..., 0] > 1e-9, offsets, np.inf)


class _Prism(NamedTuple):
    corners: Array
    bottom_m: float
    top_m: float
    material: str
    along_m: float = 0.0
    above_m: float = 0.0
    is_flat: bool = False


def solids_of(world: World) -> Solids:
    """Return all prisms of the world, in the order of its file."""
    prisms: list[_Prism] = []
    for wall in world.walls:
        prisms += _wall(wall, world.ceiling_m)
    prisms += [_post(post, world.ceiling_m) for post in world.posts]
    prisms += [_box(box) for box in world.furniture]
    return _stacked(prisms)


def clearance_m(solids: Solids, points: Array, height_m: float) -> Array:
    """Return the distance (T,) of floor points (T, 2) from the nearest solid that a robot of this height would hit.

    Negative inside a solid; infinite in an empty world.
    """
    low = solids.bottom_m < height_m
    normals, offsets = solids.half_planes()
    normals, offsets, corners = normals[low], offsets[low], solids.corners[low]
    if not len(corners):
        return np.full(len(points), np.inf)
    outside = np.einsum("pkd,td->tpk", normals, points) - offsets
    start, end = corners, np.roll(corners, -1, axis=1)
    side = end - start
    power = np.maximum((side**2).sum(axis=-1), 1e-12)
    from_start = points[:, None, None, :] - start
    share = np.clip((from_start * side).sum(axis=-1) / power, 0.0, 1.0)
    distance = np.linalg.norm(from_start - share[..., None] * side, axis=-1).min(axis=2)
    return np.asarray(np.where((outside <= 0).all(axis=2), -distance, distance).min(axis=1))


def _stacked(prisms: Sequence[_Prism]) -> Solids:
    most = max((len(prism.corners) for prism in prisms), default=4)
    corners = [np.concatenate([p.corners, np.repeat(p.corners[-1:], most - len(p.corners), axis=0)]) for p in prisms]
    bottom, top, along, above = np.array([(p.bottom_m, p.top_m, p.along_m, p.above_m) for p in prisms]).reshape(-1, 4).T
    return Solids(
        np.array(corners).reshape(len(prisms), most, 2), bottom, top, tuple(p.material for p in prisms), along, above,
        np.array([p.is_flat for p in prisms], dtype=bool),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """The centre line of a wall: footprints are given along it and to its right."""

    wall: Wall

    @property
    def pose(self) -> Array:
        """The pose at `from`, facing `to`."""
        (x, z), (x_end, z_end) = self.wall.start, self.wall.end
        return np.array([x, z, np.arctan2(x - x_end, z - z_end)])

    def footprint(self, along: tuple[float, float], right: tuple[float, float]) -> Array:
        """Return the corners (4, 2) of a rectangle, given in metres from `from` and to the right of the line."""
        (near, far), (left, right_) = along, right
        corners = np.array([[right_, -near], [right_, -far], [left, -far], [left, -near]])
        return geometry.map_from_robot(self.pose, corners)


def _wall(wall: Wall, ceiling_m: float) -> Iterator[_Prism]:
    line, half, top = _Line(wall), wall.thickness_m / 2, wall.height_m or ceiling_m
    begin = -half
    for door in sorted(wall.doors, key=lambda d: d.at_m):
        opening = (door.at_m - door.width_m / 2, door.at_m + door.width_m / 2)
        yield _Prism(line.footprint((begin, opening[0]), (-half, half)), 0.0, top, wall.material, begin)
        if door.height_m < top:
            yield _Prism(line.footprint(opening, (-half, half)), door.height_m, top, wall.material, opening[0])
        yield from _door(line, door, opening, top)
        begin = opening[1]
    yield _Prism(line.footprint((begin, wall.length_m + half), (-half, half)), 0.0, top, wall.material, begin)
    for poster in wall.posters:
        along = (poster.at_m - poster.width_m / 2, poster.at_m + poster.width_m / 2)
        right = (half, half + POSTER_DEPTH_M) if poster.side == "right" else (-half - POSTER_DEPTH_M, -half)
        bottom = poster.bottom_m
        yield _Prism(line.footprint(along, right), bottom, poster.top_m, poster.material, 0.0, bottom, True)


def _door(line: _Line, door: Door, opening: tuple[float, float], top: float) -> Iterator[_Prism]:
    """Yield the frame, which covers the wall beside and above the opening and lines it by 2 cm, and the leaf."""
    depth = line.wall.thickness_m / 2 + door.frame_out_m
    if door.frame_m > 0:
        lining = 0.02
        jambs = ((opening[0] - door.frame_m, opening[0] + lining), (opening[1] - lining, opening[1] + door.frame_m))
        head = min(door.height_m + door.frame_m, top)
        for jamb in jambs:
            yield _Prism(line.footprint(jamb, (-depth, depth)), 0.0, head, door.frame_material)
        across = (opening[0] + lining, opening[1] - lining)
        yield _Prism(line.footprint(across, (-depth, depth)), door.height_m - lining, head, door.frame_material)
        opening = across
    if door.leaf:
        yield _leaf(line, door.leaf, opening, door.height_m - 0.02)


def _leaf(line: _Line, leaf: Leaf, opening: tuple[float, float], top: float) -> _Prism:
    half = leaf.thickness_m / 2
    # An open leaf hinges half its thickness inside the opening, so that it clears the jamb; a closed one fills it.
    inset = half if leaf.angle_deg > 0 else 0.0
    hinge_at, turn = (opening[0] + inset, 0.0) if leaf.hinge == "from" else (opening[1] - inset, np.pi)
    swing = np.deg2rad(leaf.angle_deg) * (1 if (leaf.side == "left") == (leaf.hinge == "from") else -1)
    hinge = geometry.compose(line.pose, np.array([0.0, -hinge_at, turn + swing]))
    end = inset - (opening[1] - opening[0] - inset)
    corners = np.array([[half, inset], [half, end], [-half, end], [-half, inset]])
    return _Prism(geometry.map_from_robot(hinge, corners), 0.005, top, leaf.material)


def _post(post: Post, ceiling_m: float) -> _Prism:
    # Heading pi/sides puts a flat side ahead; four sides are given by their side, not by their diagonal.
    angles = np.pi / post.sides + 2 * np.pi * np.arange(post.sides) / post.sides
    radius = post.width_m / np.sqrt(2) if post.sides == 4 else post.width_m / 2
    corners = radius * geometry.forward(angles)
    pose = np.array([post.x, post.z, np.deg2rad(post.rotation_deg)])
    top = post.top_m or ceiling_m
    return _Prism(geometry.map_from_robot(pose, corners), post.bottom_m, top, post.material)


def _box(box: Box) -> _Prism:
    right, back = box.width_m / 2, box.depth_m / 2
    corners = np.array([[right, back], [right, -back], [-right, -back], [-right, back]])
    pose = np.array([box.x, box.z, np.deg2rad(box.rotation_deg)])
    return _Prism(geometry.map_from_robot(pose, corners), box.bottom_m, box.top_m, box.material, above_m=box.bottom_m)
