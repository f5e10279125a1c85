"""The vertical edges of a world, which are its landmarks, and what of them a camera sees."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, in_camera
from localiser.simulate.level_view import NEAR_M, cast
from localiser.simulate.solids import Solids, solids_of
from localiser.simulate.world import World

# -- the edges of a world ---------------------------------------------------------------------------------------------

MERGE_M = 0.02  # edges nearer to each other are one landmark: no camera here tells them apart
SHORTEST_M = 0.1  # what is lower is no landmark
_CIRCLE_M = 0.0015
_DIRECTIONS = (np.arange(96) + 0.5) * 2 * np.pi / 96


@dataclass(frozen=True, slots=True, eq=False)
class VerticalEdges:
    """Vertical edges of the geometry, M of them: points (M, 2) x, z, bottom_m, top_m (M,), is_flat (M,) of pictures."""

    points: Array
    bottom_m: Array
    top_m: Array
    is_flat: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """The solids of a world, their vertical edges (M), and the landmark (M,) that each is part of, -1 for none."""

    solids: Solids
    edges: VerticalEdges
    landmark: NDArray[np.int64]
    landmark_map: LandmarkMap


def structure_of(world: World) -> Structure:
    """Return the geometry of a world: what hides things, and what is seen."""
    solids = solids_of(world)
    edges = vertical_edges(solids)
    landmark = landmark_of_edges(edges)
    return Structure(solids, edges, landmark, landmark_map_of(edges, landmark, world.name))


def vertical_edges(solids: Solids) -> VerticalEdges:
    """Return every vertical edge of the solids, with its lower and upper height.

    Candidates are corners of footprints and crossings of their sides. One is an edge at the heights at which
    a horizontal cut through the solids has a corner there: its neighbourhood is not full, not empty and not a straight
    side.
    """
    structure = _edges_of(solids, ~solids.is_flat)
    with_pictures = _edges_of(solids, np.ones(len(solids), dtype=bool)) if solids.is_flat.any() else []
    known = {(round(x, 4), round(z, 4)) for x, z, _, _ in structure}
    pictures = [edge for edge in with_pictures if (round(edge[0], 4), round(edge[1], 4)) not in known]
    columns = np.array(structure + pictures).reshape(-1, 4)
    is_flat = np.arange(len(columns)) >= len(structure)
    return VerticalEdges(columns[:, :2], columns[:, 2], columns[:, 3], is_flat)


def landmark_of_edges(edges: VerticalEdges) -> NDArray[np.int64]:
    """Return for each edge (M,) the landmark that it is part of, counted from 0, or -1 for one that is none."""
    stands = ~edges.is_flat & (edges.top_m - edges.bottom_m >= SHORTEST_M)
    index = np.flatnonzero(stands)
    distance = np.linalg.norm(edges.points[index, None] - edges.points[None, index], axis=-1)
    group = np.arange(len(index))
    for i, j in zip(*np.nonzero(np.triu(distance < MERGE_M, k=1)), strict=True):
        group[group == group[j]] = group[i]
    landmark = np.full(len(edges), -1, dtype=np.int64)
    landmark[index] = np.unique(group, return_inverse=True)[1]
    return landmark


def landmark_map_of(edges: VerticalEdges, landmark: NDArray[np.int64], name: str) -> LandmarkMap:
    """Return the map of landmarks (L), each in the middle of its edges and from the lowest to the highest of them."""
    groups = [np.flatnonzero(landmark == k) for k in range(landmark.max(initial=-1) + 1)]
    return LandmarkMap.from_points(
        np.array([edges.points[group].mean(axis=0) for group in groups]).reshape(-1, 2),
        name=name,
        bottom_m=np.array([edges.bottom_m[group].min() for group in groups]),
        top_m=np.array([edges.top_m[group].max() for group in groups]),
        source="simulated",
    )


def _edges_of(solids: Solids, chosen: NDArray[np.bool_]) -> list[tuple[float, float, float, float]]:
    normals, offsets = (column[chosen] for column in solids.half_planes())
    corners, bottom, top = solids.corners[chosen], solids.bottom_m[chosen], solids.top_m[chosen]
    circle = _CIRCLE_M * np.stack([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)], axis=-1)
    edges = []
    for point in _candidates(corners):
        near = (((normals @ point) - offsets) <= 2 * _CIRCLE_M).all(axis=1)
        across = np.einsum("pkd,sd->psk", normals[near], point + circle) - offsets[near, None, :]
        filled = (across <= 1e-9).all(axis=2)
        for low, high in _heights_of_corner(filled, bottom[near], top[near]):
            edges.append((float(point[0]), float(point[1]), low, high))
    return edges


def _heights_of_corner(filled: NDArray[np.bool_], bottom: Array, top: Array) -> Iterator[tuple[float, float]]:
    """Yield the height ranges at which the cut round one point, filled (P, S) by each solid, has a corner."""
    levels = np.unique(np.concatenate([bottom, top]))
    start = None
    for low, high in pairwise(levels):
        standing = (bottom <= low) & (top >= high)
        # A small circle round a corner, filled or not in each direction, shows more than nothing, all, or one half.
        circle = filled[standing].any(axis=0)
        count, changes = int(circle.sum()), int((circle != np.roll(circle, 1)).sum())
        is_corner = changes > 2 or (changes == 2 and abs(count - len(circle) / 2) > 1)
        if is_corner and start is None:
            start = float(low)
        if not is_corner and start is not None:
            yield start, float(low)
            start = None
    if start is not None:
        yield start, float(levels[-1])


def _candidates(corners: Array) -> Array:
    """Return corners and crossings of sides (C, 2) of footprints (P, K, 2), each once."""
    start = corners.reshape(-1, 2)
    side = np.roll(corners, -1, axis=1).reshape(-1, 2) - start
    real = np.linalg.norm(side, axis=1) > 1e-9
    start, side = start[real], side[real]
    gap = start[None] - start[:, None]
    turn = side[:, None, 0] * side[None, :, 1] - side[:, None, 1] * side[None, :, 0]
    parallel = np.abs(turn) < 1e-12
    turn = np.where(parallel, 1.0, turn)
    along = (gap[..., 0] * side[None, :, 1] - gap[..., 1] * side[None, :, 0]) / turn
    other = (gap[..., 0] * side[:, None, 1] - gap[..., 1] * side[:, None, 0]) / turn
    crosses = ~parallel & (along >= 0) & (along <= 1) & (other >= 0) & (other <= 1)
    first, second = np.nonzero(np.triu(crosses, k=1))
    crossings = start[first] + along[first, second, None] * side[first]
    points = np.concatenate([corners.reshape(-1, 2), crossings])
    _, once = np.unique(np.round(points, 6), axis=0, return_index=True)
    return points[np.sort(once)]


# -- what a camera sees -----------------------------------------------------------------------------------------------

Mask = NDArray[np.bool_]

_SAMPLES = 128  # along each edge's part in the image
_BESIDE_M = 0.0005  # an edge is looked at just left and just right of it
_BEHIND_M = 0.015  # what is hit no further before the edge than this is the edge's own surface


@dataclass(frozen=True, slots=True, eq=False)
class Visible:
    """Landmarks that an image shows, V of them.

    landmark: (V,) index in the structure's map. ends_px: (V, 2, 2) lowest and highest visible sample (u, v). fraction:
    (V,) visible part of the landmark's height. Contrast is not considered.
    """

    landmark: NDArray[np.int64]
    ends_px: Array
    fraction: Array

    def __len__(self) -> int:
        return len(self.landmark)


def visible_landmarks(structure: Structure, camera: Camera, robot_pose: Array) -> Visible:
    """Return the landmarks inside the camera's image that no solid hides, seen from a robot at (3,) in the map.

    An edge is seen at a height when the line of sight just left or just right of it reaches it.
    """
    camera_pose = camera.pose_in_map(robot_pose)
    right, ahead = (axis[0] for axis in in_camera(camera_pose[None], structure.edges.points))
    low, high = (limit(_border_rays(camera)[:, 0]) for limit in (np.min, np.max))
    candidate = (structure.landmark >= 0) & (ahead > NEAR_M)
    candidate &= (right >= low * ahead) & (right <= high * ahead)
    edge = np.flatnonzero(candidate)
    tangent, ahead = right[edge] / ahead[edge], ahead[edge]
    bottom, top = structure.edges.bottom_m[edge], structure.edges.top_m[edge]
    points = _samples(camera, tangent, ahead, bottom, top)
    pixels = camera.project_level(points)
    size = np.array([camera.width, camera.height])
    inside = ((pixels >= -0.5) & (pixels <= size - 0.5)).all(axis=-1)
    offset = _BESIDE_M * np.hypot(1.0, tangent) / ahead
    left, right = (_is_reached(structure, camera, camera_pose, tangent + side * offset, points) for side in (-1, 1))
    return _by_landmark(structure.landmark[edge], points, pixels, inside & (left | right), top - bottom)


def _border_rays(camera: Camera) -> Array:
    """Return rays of the level frame (R, 3) through the rim of the image, scaled to one metre ahead."""
    rays = camera.level_rays(camera.border_px(33, 0.5).reshape(-1, 2))
    return rays / np.maximum(-rays[:, 2:], 1e-3)


def _samples(camera: Camera, tangent: Array, ahead: Array, bottom: Array, top: Array) -> Array:
    """Return points (M, S, 3) of the level frame along edges, within the heights that the image can show at all."""
    elevation = _border_rays(camera)[:, 1]
    low, high = elevation.min() * ahead, elevation.max() * ahead
    first = np.clip(bottom - camera.mount.height_m, low, high)
    last = np.clip(top - camera.mount.height_m, low, high)
    height = first[:, None] + (last - first)[:, None] * np.linspace(0, 1, _SAMPLES)
    return np.stack(np.broadcast_arrays((tangent * ahead)[:, None], height, -ahead[:, None]), axis=-1)


def _is_reached(structure: Structure, camera: Camera, camera_pose: Array, beside: Array, points: Array) -> Mask:
    """Return where (M, S) lines of sight in the directions `beside` (M,), tan(bearing), get as far as the edges.

    points: (M, S, 3) samples of the edges in the level frame.
    """
    ahead = -points[:, 0, 2]
    elevation = points[..., 1] / ahead[:, None]
    hits = cast(structure.solids, camera_pose, beside)
    before = hits.entry < ahead - _BEHIND_M / np.hypot(1.0, beside)
    in_front = np.flatnonzero(before.any(axis=1))
    entry, leave = hits.entry[in_front], np.minimum(hits.leave[in_front], ahead)
    # A solid hides the elevations between the lowest and the highest of its four ends: bottom and top, near and far.
    eye = camera.mount.height_m
    bottom, top = (height[in_front, None] - eye for height in (structure.solids.bottom_m, structure.solids.top_m))
    low = np.where(before[in_front], np.minimum(bottom / entry, bottom / leave), np.inf)
    high = np.where(before[in_front], np.maximum(top / entry, top / leave), -np.inf)
    hidden = (elevation >= low[..., None]) & (elevation <= high[..., None])
    return np.asarray(~hidden.any(axis=0))


def _by_landmark(landmark: NDArray[np.int64], points: Array, pixels: Array, shown: Mask, length_m: Array) -> Visible:
    """Return what is shown of each landmark: its edges' samples (M, S) together."""
    # One sample alone is the end of an edge that something hides.
    shown = shown & (shown.sum(axis=1, keepdims=True) > 1)
    step = np.ptp(points[..., 1], axis=1) / (points.shape[1] - 1)
    fraction = np.minimum(shown.sum(axis=1) * step / length_m, 1.0)
    ids, ends, fractions = [], [], []
    for index in np.unique(landmark[shown.any(axis=1)]):
        own = landmark == index
        seen, height = pixels[own][shown[own]], points[own][shown[own], 1]
        ids.append(index)
        ends.append([seen[height.argmin()], seen[height.argmax()]])
        fractions.append(fraction[own].max())
    return Visible(np.array(ids, dtype=np.int64), np.array(ends).reshape(-1, 2, 2), np.array(fractions))
