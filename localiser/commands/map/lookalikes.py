"""Where a building looks like another part of itself: places, a picture, and what would help."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from localiser import mapping
from localiser.camera import Camera
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable

_STEP_M, _MOST_PLACES = 0.25, 300
_NEAR_PATH_M = 1.5  # the robot may come so far off a path that it has driven
_NEAR_LANDMARK_M = 0.5  # walls and furniture, to which a new landmark could be fixed, stand where landmarks are
_ARROWS = 6
_ARROW_APART_M = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Lookalikes:
    """What looks like what from places (P, 2), and the spots where one more landmark would help most.

    share: (P,) of headings from which another place looks the same.
    """

    places: Array
    step_m: float
    share: Array
    found: mapping.Ambiguity
    spots: list[mapping.Spot]

    @property
    def spots_at(self) -> Array:
        """Where the spots (S, 2) are."""
        return np.array([[spot.x, spot.z] for spot in self.spots]).reshape(-1, 2)

    def examples(self) -> tuple[Array, Array]:
        """Return a few poses (K, 3) that look most like others, far from each other, and those others (K, 3).

        Where less is in view than fixes a pose, much looks alike, and no example says anything.
        """
        chosen: list[int] = []
        telling = self.found.alike & (self.found.shown >= mapping.ENOUGH)
        for index in np.argsort(self.found.nats, kind="stable"):
            here = self.found.poses[index, :2]
            apart = [float(np.hypot(*(here - self.found.poses[k, :2]))) for k in chosen]
            if telling[index] and all(distance > _ARROW_APART_M for distance in apart):
                chosen.append(int(index))
            if len(chosen) == _ARROWS:
                break
        return self.found.poses[chosen], self.found.twins[chosen]


def lookalikes(landmark_map: LandmarkMap, camera: Camera, path: Array | None) -> Lookalikes:
    """Return what looks alike all over the building; with a path (T, 3) that was driven, near it only."""
    step, places = _STEP_M, _places(landmark_map, path, _STEP_M)
    while len(places) > _MOST_PLACES:
        step *= max(1.05, float(np.sqrt(len(places) / _MOST_PLACES)))
        places = _places(landmark_map, path, step)
    found = mapping.ambiguity(landmark_map, camera, places)
    near = _within(places, landmark_map.points, _NEAR_LANDMARK_M + step / 2)
    spots = mapping.best_spots(found, camera, places[near] if near.any() else places)
    return Lookalikes(places, step, found.alike.reshape(len(places), -1).mean(axis=1), found, spots)


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


def lookalikes_text(look: Lookalikes) -> str:
    """Return how much of the building looks like another part of it, and what would help."""
    text = (
        f"Looks like another place, to one image: {100 * look.found.alike.mean():.0f} % of {len(look.places)} places "
        f"and headings, {100 * (look.found.alike & (look.found.shown >= mapping.ENOUGH)).mean():.0f} % although "
        f"{mapping.ENOUGH} or more landmarks are in view"
    )
    for spot in look.spots:
        text += f"\n  a landmark near x = {spot.x:.1f}, z = {spot.z:.1f} would leave {100 * spot.alike_share:.0f} %"
    return text


def draw(look: Lookalikes, axes: Axes) -> ScalarMappable:
    """Draw from which share of headings a place looks like another, where that other is, and the spots that help."""
    x, z = look.places.T
    columns = np.round((x - x.min()) / look.step_m).astype(int)
    rows = np.round((z - z.min()) / look.step_m).astype(int)
    picture = np.full((rows.max() + 1, columns.max() + 1), np.nan)
    picture[rows, columns] = 100 * look.share
    half = look.step_m / 2
    extent = (x.min() - half, x.max() + half, z.max() + half, z.min() - half)
    shown = axes.imshow(picture, extent=extent, vmin=0, vmax=100, cmap="YlOrRd", interpolation="nearest")
    for pose, twin in zip(*look.examples(), strict=True):
        axes.annotate(
            "",
            twin[:2],
            pose[:2],
            arrowprops={"arrowstyle": "->", "color": "#333333", "linewidth": 0.9, "connectionstyle": "arc3,rad=0.15"},
        )
    if look.spots:
        axes.scatter(
            look.spots_at[:, 0],
            look.spots_at[:, 1],
            s=90,
            marker="*",
            color="#2a9d3f",
            edgecolors="white",
            linewidths=0.8,
            zorder=5,
            label="a landmark here would help most",
        )
    return shown
