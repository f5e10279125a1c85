"""The paper's motions, before rendered images: the turns of its table 2 on the spot, and driving straight ahead."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.commands.paper.arithmetic import TABLE_2, TILT_2_DEG
from localiser.commands.paper.room import SIZES, camera_of, draw_places, room
from localiser.edges import EdgeParameters, Edges, find_edges
from localiser.geometry import Array
from localiser.simulate import Scene, render, scene_of, visible_landmarks

DETECTORS = ("hough", "columns")
"""What the paper used, and ours."""
TURNS_RAD = np.deg2rad([delta for _, delta, _ in TABLE_2])
"""From each view to the next, as the paper's camera turned by its extrinsic parameters."""
VIEWS = len(TURNS_RAD) + 1
DRIVE_M = 0.25
_NEAR_RAD = np.deg2rad(1.0)

Index = NDArray[np.int64]
Image = NDArray[np.uint8]
Measured = dict[tuple[tuple[int, int], str], list["Place"]]
"""Places by the size of the image and the detector."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The edges of one view that show a landmark, K of them: which (K,), and the edges (K)."""

    landmark: Index
    edges: Edges


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """What was seen at one place in the room.

    turned: VIEWS views, each turned right by `TURNS_RAD` from the one before. ahead: the view from DRIVE_M further on
    than the first. points: (L, 2) landmarks in the camera's level frame of the first view. images: of all views.
    """

    turned: tuple[Seen, ...]
    ahead: Seen
    points: Array
    images: tuple[Image, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """What two views of the same K edges say, by slope and by line.

    landmark: (K,). slope, line: (K, 2) lean by the free line, and bearing by the line through the nadir point, of the
    first and the second view. slope_sigma, line_sigma: (K, 2) of the bearings by each. points: (K, 2) x, z at first.
    """

    landmark: Index
    slope: Array
    line: Array
    slope_sigma: Array
    line_sigma: Array
    points: Array


def steps(places: int) -> int:
    """Return how many times `measure` calls its progress."""
    return places * len(SIZES)


def measure(places: int, seed: int, progress: Callable[[], None]) -> Measured:
    """Return what each detector saw at each size of the image, at the same places in the room."""
    poses = draw_places(places, DRIVE_M, np.random.default_rng([seed, 0]))
    found: Measured = {}
    for size in SIZES:
        scene = scene_of(room(), camera_of(size, TILT_2_DEG))
        for index, pose in enumerate(poses):
            for detector, place in _at_place(scene, pose, np.random.default_rng([seed, size[0], index])):
                found.setdefault((size, detector), []).append(place)
            progress()
    return found


def _at_place(scene: Scene, pose: Array, rng: np.random.Generator) -> Iterator[tuple[str, Place]]:
    turns = [geometry.compose(pose, np.array([0.0, 0.0, -turn_rad(0, view)])) for view in range(VIEWS)]
    poses = [*turns, geometry.compose(pose, np.array([0.0, -DRIVE_M, 0.0]))]
    images = [render(scene, view, rng) for view in poses]
    points = geometry.robot_from_map(pose, scene.structure.landmark_map.points)
    for detector in DETECTORS:
        parameters = EdgeParameters(detector=detector)  # type: ignore[arg-type]
        views = [
            _seen(find_edges(image, scene.camera, parameters), scene, view)
            for image, view in zip(images, poses, strict=True)
        ]
        yield detector, Place(tuple(views[:-1]), views[-1], points, tuple(images))


def _seen(edges: Edges, scene: Scene, pose: Array) -> Seen:
    """Return the edges that show a landmark: each the other's nearest, within a degree.

    The paper marks edges by hand or follows them by eye; here the true map does it, so that what is judged is how well
    an edge is measured, not whether it is recognised.
    """
    visible = visible_landmarks(scene.structure, scene.camera, pose).landmark
    points = geometry.robot_from_map(pose, scene.structure.landmark_map.points[visible])
    apart = np.abs(edges.bearing[:, None] - geometry.bearing_from_point(*points.T))
    if apart.size == 0:
        return Seen(np.zeros(0, dtype=np.int64), edges.take(np.zeros(0, dtype=np.int64)))
    nearest, backwards = apart.argmin(axis=1), apart.argmin(axis=0)
    everyone = np.arange(len(edges))
    kept = np.flatnonzero((backwards[nearest] == everyone) & (apart[everyone, nearest] < _NEAR_RAD))
    return Seen(visible[nearest[kept]], edges.take(kept))


# -- pairs of views ---------------------------------------------------------------------------------------------------


def pair_of(first: Seen, second: Seen, points: Array, camera: Camera) -> Pair:
    """Return the edges that both views show with the same polarity. points: (L, 2) in the first view's frame."""
    _, one, two = np.intersect1d(first.landmark, second.landmark, return_indices=True)
    alike = first.edges.polarity[one] == second.edges.polarity[two]
    views = first.edges.take(one[alike]), second.edges.take(two[alike])
    bearing = np.stack([edges.bearing for edges in views], axis=-1)
    lean_sigma = np.stack([edges.lean_sigma for edges in views], axis=-1)
    landmark = first.landmark[one[alike]]
    return Pair(
        landmark,
        np.stack([edges.lean for edges in views], axis=-1),
        bearing,
        lean_sigma * geometry.bearing_per_lean(bearing, camera.mount.tilt_rad),
        np.stack([edges.bearing_sigma for edges in views], axis=-1),
        points[landmark],
    )


def turn_rad(first: int, by: int) -> float:
    """Return how far the camera turns right from view `first` by so many turns."""
    return float(TURNS_RAD[first : first + by].sum())


def turns(places: list[Place], by: int, camera: Camera) -> list[tuple[Pair, float]]:
    """Return the pairs of views that lie `by` turns apart, each with the true turn (rad)."""
    return [
        (pair_of(place.turned[first], place.turned[first + by], place.points, camera), turn_rad(first, by))
        for place in places
        for first in range(VIEWS - by)
    ]


def drives(places: list[Place], camera: Camera) -> list[Pair]:
    """Return the pairs of views before and after driving ahead."""
    return [pair_of(place.turned[0], place.ahead, place.points, camera) for place in places]


def turn_by_slope(pair: Pair, tilt_rad: float) -> Array:
    """Return how far (K,) rad the camera turned right by each edge's slopes. [Taylor06] eq. 13."""
    slope = geometry.slope_from_lean(pair.slope)
    return -geometry.rotation_from_slopes(slope[:, 0], slope[:, 1], tilt_rad)


def turn_by_line(pair: Pair) -> Array:
    """Return how far (K,) rad the camera turned right by each edge's bearings: the same, with position and slope."""
    return np.asarray(pair.line[:, 0] - pair.line[:, 1])


def slopes_of(pair: Pair, kind: str, tilt_rad: float) -> Array:
    """Return the paper's slopes m (K, 2), as measured or, for `line`, as the bearings say."""
    lean = pair.slope if kind == "slope" else geometry.lean_from_bearing(pair.line, tilt_rad)
    return geometry.slope_from_lean(lean)


def tracked(place: Place) -> Index:
    """Return the landmarks that are measured in all turned views of a place."""
    common = place.turned[0].landmark
    for view in place.turned[1:]:
        common = np.intersect1d(common, view.landmark)
    return common.astype(np.int64)
