"""The paper's motions before rendered images: the turns of its table 2 on the spot, and driving straight ahead.

Edges are assigned to landmarks by the true map. The paper marks them by hand or follows them by eye; what is judged is
how well an edge is measured, not whether it is recognised.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.edges import EdgeParameters, Edges, find_edges
from localiser.geometry import Array
from localiser.simulate import Scene, render, scene_of, visible_landmarks
from paper.equations import TABLE_2, TILT_2_DEG
from paper.room import SIZES, Size, camera_of, draw_places, room
from paper.slopes import rotation_from_slopes

TILT_RAD = float(np.deg2rad(TILT_2_DEG))
DETECTORS = ("hough", "columns")
"""What the paper used, and ours."""
TURNS_RAD = np.deg2rad([delta for _, delta, _ in TABLE_2])
"""From each view to the next, as the paper's camera turned by its extrinsic parameters."""
VIEWS = len(TURNS_RAD) + 1
DRIVE_M = 0.25
_NEAR_RAD = np.deg2rad(1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The edges of one view that show a landmark, K of them: which (K,), and the edges (K)."""

    landmark: NDArray[np.int64]
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
    images: tuple[NDArray[np.uint8], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """The edges (K) that two views show of the same landmarks (K,), with the same polarity."""

    landmark: NDArray[np.int64]
    first: Edges
    second: Edges


Measured = dict[tuple[Size, str], list[Place]]
"""Places by the size of the image and the detector."""


def measure(places: int, seed: int) -> Measured:
    """Return what each detector saw at each size of the image, at the same places in the room."""
    poses = draw_places(places, DRIVE_M, np.random.default_rng([seed, 0]))
    found: Measured = {(size, detector): [] for size in SIZES for detector in DETECTORS}
    for size in SIZES:
        scene = scene_of(room(), camera_of(size, TILT_2_DEG))
        for index, pose in enumerate(poses):
            for detector, place in _at_place(scene, pose, np.random.default_rng([seed, size[0], index])):
                found[size, detector].append(place)
    return found


def _at_place(scene: Scene, pose: Array, rng: np.random.Generator) -> Iterator[tuple[str, Place]]:
    motions = [np.array([0.0, 0.0, -turn_rad(0, view)]) for view in range(VIEWS)] + [np.array([0.0, -DRIVE_M, 0.0])]
    poses = [geometry.compose(pose, motion) for motion in motions]
    images = tuple(render(scene, view, rng) for view in poses)
    points = geometry.robot_from_map(pose, scene.structure.landmark_map.points)
    for detector in DETECTORS:
        parameters = EdgeParameters(detector=detector)
        found = (find_edges(image, scene.camera, parameters) for image in images)
        *turned, ahead = (_seen(edges, scene, view) for edges, view in zip(found, poses, strict=True))
        yield detector, Place(tuple(turned), ahead, points, images)


def _seen(edges: Edges, scene: Scene, pose: Array) -> Seen:
    """Return the edges that show a landmark: each the other's nearest, within a degree."""
    visible = visible_landmarks(scene.structure, scene.camera, pose).landmark
    points = geometry.robot_from_map(pose, scene.structure.landmark_map.points[visible])
    apart = np.abs(edges.bearing[:, None] - np.arctan2(points[:, 0], -points[:, 1]))
    if apart.size == 0:
        return Seen(np.zeros(0, dtype=np.int64), edges.take(np.zeros(0, dtype=np.int64)))
    nearest, backwards = apart.argmin(axis=1), apart.argmin(axis=0)
    everyone = np.arange(len(edges))
    kept = np.flatnonzero((backwards[nearest] == everyone) & (apart[everyone, nearest] < _NEAR_RAD))
    return Seen(visible[nearest[kept]], edges.take(kept))


# -- pairs of views ---------------------------------------------------------------------------------------------------


def pair_of(first: Seen, second: Seen) -> Pair:
    """Return the edges that both views show with the same polarity."""
    landmark, one, two = np.intersect1d(first.landmark, second.landmark, return_indices=True)
    alike = first.edges.polarity[one] == second.edges.polarity[two]
    return Pair(landmark[alike], first.edges.take(one[alike]), second.edges.take(two[alike]))


def turn_rad(first: int, by: int) -> float:
    """Return how far the camera turns right from view `first` by so many turns."""
    return float(TURNS_RAD[first : first + by].sum())


def turns(places: list[Place], by: int) -> list[tuple[Pair, float]]:
    """Return the pairs of views that lie `by` turns apart, each with the true turn (rad)."""
    return [
        (pair_of(place.turned[first], place.turned[first + by]), turn_rad(first, by))
        for place in places
        for first in range(VIEWS - by)
    ]


def slopes(edges: Edges, kind: str) -> Array:
    """Return the paper's slopes m (K,), as measured or, where kind is `line`, as the bearings say."""
    lean = edges.lean if kind == "slope" else geometry.lean_from_bearing(edges.bearing, TILT_RAD)
    return geometry.slope_from_lean(lean)


def turn_of_edges(first: Edges, second: Edges, kind: str) -> tuple[Array, Array]:
    """Return how far (K,) rad the camera turned right by each of K edges in two views, and sigmas (K,).

    [Taylor06] eq. 13.
    """
    turn = -rotation_from_slopes(slopes(first, kind), slopes(second, kind), TILT_RAD)
    one, two = (
        edges.bearing_sigma if kind == "line" else edges.lean_sigma * geometry.bearing_per_lean(edges.bearing, TILT_RAD)
        for edges in (first, second)
    )
    return turn, np.hypot(one, two)
