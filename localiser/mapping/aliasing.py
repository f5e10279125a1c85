"""Perceptual aliasing: parts of a building that look alike, and where one more landmark would help most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.camera import Camera
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.mapping.ambiguity import Ambiguity, Spot, best_spots, find_ambiguity
from localiser.mapping.check import ENOUGH

_STEP_M, _MOST_PLACES = 0.25, 300
_NEAR_PATH_M = 1.5  # the robot may come so far off a path that it has driven
_NEAR_LANDMARK_M = 0.5  # walls and furniture, to which a new landmark could be fixed, stand where landmarks are
_ARROWS = 6
_ARROW_APART_M = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Aliasing:
    """What looks like what from places (P, 2), and the spots where one more landmark would help most.

    share: (P,) of headings from which another place looks the same.
    """

    places: Array
    step_m: float
    share: Array
    found: Ambiguity
    spots: list[Spot]

    @property
    def spots_at(self) -> Array:
        """Where the spots (S, 2) are."""
        return np.array([[spot.x, spot.z] for spot in self.spots]).reshape(-1, 2)

    def examples(self) -> tuple[Array, Array]:
        """Return a few poses (K, 3) that look most like others, far from each other, and those others (K, 3).

        Where less is in view than fixes a pose, much looks alike, and no example says anything.
        """
        chosen: list[int] = []
        telling = self.found.alike & (self.found.shown >= ENOUGH)
        for index in np.argsort(self.found.nats, kind="stable"):
            here = self.found.poses[index, :2]
            apart = [float(np.hypot(*(here - self.found.poses[k, :2]))) for k in chosen]
            if telling[index] and all(distance > _ARROW_APART_M for distance in apart):
                chosen.append(int(index))
            if len(chosen) == _ARROWS:
                break
        return self.found.poses[chosen], self.found.twins[chosen]

    def text(self) -> str:
        """Return how much of the building looks like another part of it, and what would help."""
        text = (
            f"Looks like another place, to one image: {100 * self.found.alike.mean():.0f} % of {len(self.places)} "
            f"places and headings, {100 * (self.found.alike & (self.found.shown >= ENOUGH)).mean():.0f} % although "
            f"{ENOUGH} or more landmarks are in view"
        )
        for spot in self.spots:
            text += f"\n  a landmark near x = {spot.x:.1f}, z = {spot.z:.1f} would leave {100 * spot.alike_share:.0f} %"
        return text


def find_aliasing(landmark_map: LandmarkMap, camera: Camera, path: Array | None) -> Aliasing:
    """Return what looks alike all over the building; with a path (T, 3) that was driven, near it only."""
    step, places = _STEP_M, _places(landmark_map, path, _STEP_M)
    while len(places) > _MOST_PLACES:
        step *= max(1.05, float(np.sqrt(len(places) / _MOST_PLACES)))
        places = _places(landmark_map, path, step)
    found = find_ambiguity(landmark_map, camera, places)
    near = _within(places, landmark_map.points, _NEAR_LANDMARK_M + step / 2)
    spots = best_spots(found, camera, places[near] if near.any() else places)
    return Aliasing(places, step, found.alike.reshape(len(places), -1).mean(axis=1), found, spots)


def _places(landmark_map: LandmarkMap, path: Array | None, step_m: float) -> Array:
    """Return places (P, 2) at equal steps where the robot may be."""
    around, margin = (landmark_map.points, 0.0) if path is None else (path[:, :2], _NEAR_PATH_M)
    low, high = around.min(axis=0) - margin, around.max(axis=0) + margin
    x, z = (np.arange(start, stop + step_m, step_m) for start, stop in zip(low, high, strict=True))
    places = np.stack([part.ravel() for part in np.meshgrid(x, z)], axis=-1)
    return places if path is None else places[_within(places, around, _NEAR_PATH_M)]


def _within(places: Array, points: Array, distance_m: float) -> np.ndarray:
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(points).query(places)[0] <= distance_m)
