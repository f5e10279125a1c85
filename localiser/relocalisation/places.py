"""The map prepared for global localisation: landmarks with ends, and their pairs sorted by distance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.geometry import Array
from localiser.landmarks import LandmarkIndex, LandmarkMap, Reach, SightParameters, half_view_rad, reach_of
from localiser.relocalisation.mixture import Region

Indices = NDArray[np.int64]

BOTTOM_STEP_M = 0.05  # landmarks whose lower ends differ by less are searched together
ENDLESS_M = 1e3
_WIDER_RAD = np.radians(5.0)  # steps of the half view that tables are made for while a mount moves
FEWEST_AS_INTEGERS = 400_000  # pairs, which are sorted faster so
MANY_PAIRS = 400_000  # beyond which pairs of edges are preferred that few pairs of landmarks can be
MOST_PAIRS = 5_000_000  # of landmarks in the table, 16 bytes each; those farthest apart are left out


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Landmarks (L) of a map, and their ordered pairs (M) by distance.

    points: (L, 2) m. bottom_m, top_m: (L,) with what the map does not know taken as floor and as endless. sigma_m: (L,)
    of each position. from_camera: (L, 4) x, z, and the heights of both ends above the camera. sight: what counts as
    visible. class_m: (B,) heights that lower ends are grouped to, ascending. pair: (M, 2) landmarks no farther apart
    than both can be in sight, sorted by `key` (M,), their distance plus a step for the group of the first times B plus
    that of the second. region: where the robot may be. index: which landmarks can be in view from where in it. reach:
    which landmarks are within range. half_view_rad: largest angle to either side that the camera sees; height_m: its
    height above the floor.
    """

    points: Array
    bottom_m: Array
    top_m: Array
    sigma_m: Array
    from_camera: Array
    sight: SightParameters
    class_m: Array
    pair: NDArray[np.int32]
    key: Array
    region: Region
    index: LandmarkIndex
    reach: Reach
    half_view_rad: float
    height_m: float

    def __len__(self) -> int:
        return len(self.points)

    @property
    def are_many(self) -> bool:
        """Whether there are so many that an image can try but a part of what it may be."""
        return len(self.pair) > MANY_PAIRS

    @property
    def sigma_max_m(self) -> float:
        """The largest error of a landmark's position."""
        return float(self.sigma_m.max())

    @classmethod
    def of(
        cls,
        landmark_map: LandmarkMap,
        camera: Camera,
        sight: SightParameters | None = None,
        region: Region | None = None,
        sigma_m: float = 0.01,
    ) -> Places:
        """Return the places of a map for a camera; sigma_m is the error of a landmark where the map is silent.

        region: where the robot may be, 1 m around the landmarks when not given.
        """
        sight = sight or SightParameters()
        points = landmark_map.points
        region = region or Region.around(points, 1.0)
        bottom_m = np.where(np.isnan(landmark_map.bottom_m), 0.0, landmark_map.bottom_m)
        top_m = np.where(np.isnan(landmark_map.top_m), ENDLESS_M, landmark_map.top_m)
        step, group = np.unique(np.round(bottom_m / BOTTOM_STEP_M).astype(np.int64), return_inverse=True)
        pair, key = _pairs(points, group.ravel(), len(step), 2 * sight.range_max_m)
        height_m, half_view = camera.mount.height_m, half_view_rad(camera)
        return cls(
            points=points,
            bottom_m=bottom_m,
            top_m=top_m,
            sigma_m=landmark_map.sigma_m(sigma_m),
            from_camera=_from_camera(points, bottom_m, top_m, height_m),
            sight=sight,
            class_m=step.astype(np.float64) * BOTTOM_STEP_M,
            pair=pair,
            key=key,
            region=region,
            index=LandmarkIndex.of(points, *_corners(region, camera), half_view, sight.range_max_m),
            reach=reach_of(landmark_map, sight.range_max_m),
            half_view_rad=half_view,
            height_m=height_m,
        )

    def seen_by(self, camera: Camera) -> Places:
        """Return the places for the camera as it is mounted now, which may sit higher and see farther to the side."""
        places, height_m, half_view = self, camera.mount.height_m, half_view_rad(camera)
        if half_view > self.half_view_rad:
            places = _widened(self, int(np.ceil(half_view / _WIDER_RAD)))
        if height_m != self.height_m:
            heights = _from_camera(self.points, self.bottom_m, self.top_m, height_m)
            places = replace(places, from_camera=heights, height_m=height_m)
        return places

    def pairs_between(self, pair_class: Indices, low_m: Array, high_m: Array) -> tuple[Indices, Indices]:
        """Return for queries (Q,) the slice first … last (Q,) of the pairs of this class at low_m … high_m (Q,)."""
        step = _key_step(2 * self.sight.range_max_m)
        first = np.searchsorted(self.key, pair_class * step + np.clip(low_m, 0.0, step - 1e-9))
        last = np.searchsorted(self.key, pair_class * step + np.clip(high_m, 0.0, step - 1e-9), side="right")
        return first, np.maximum(last, first)


def _from_camera(points: Array, bottom_m: Array, top_m: Array, height_m: float) -> Array:
    """Return x, z, and the heights of both ends above a camera at this height, (L, 4)."""
    return np.stack([*points.T, bottom_m - height_m, top_m - height_m], axis=-1)


@lru_cache(maxsize=4)
def _widened(places: Places, steps: int) -> Places:
    """Return the places with an index for so many steps of half view. The last few are kept."""
    half, low = min(steps * _WIDER_RAD, np.pi), places.index.corner
    high = low + np.array(places.index.shape[:2]) * places.index.cell_m
    index = LandmarkIndex.of(places.points, low, high, half, places.sight.range_max_m)
    return replace(places, half_view_rad=half, index=index)


def _key_step(farthest_m: float) -> float:
    """Return by how much the keys of one class of pairs lie above those of the class before: no distance reaches it."""
    return farthest_m + 1.0


def _pairs(points: Array, group: Indices, groups: int, farthest_m: float) -> tuple[NDArray[np.int32], Array]:
    """Return the ordered pairs (M, 2) of landmarks at most so far apart, and their keys (M,), ascending.

    Pairs of one class and the same distance are in the order of their first and then their second landmark.
    """
    from localiser.relocalisation import places_kernel as kernel

    reach = Reach.of(points, farthest_m)
    first, second = kernel.pairs_within(points, farthest_m, MOST_PAIRS, *reach.arguments)
    distance = np.hypot(points[first, 0] - points[second, 0], points[first, 1] - points[second, 1])
    apart = (distance > 1e-3) & (distance <= farthest_m)
    first, second, distance = first[apart], second[apart], distance[apart]
    pair_class = group[first] * groups + group[second]
    order = _by_class_and_distance(pair_class, distance, farthest_m)
    key = (pair_class * _key_step(farthest_m) + distance)[order]
    return np.stack([first[order], second[order]], axis=-1), np.maximum.accumulate(key)


def _by_class_and_distance(pair_class: Indices, distance: Array, farthest_m: float) -> Indices:
    """Return the order (M,) of pairs by class, then by distance, then as they are.

    Many are sorted as integers of class, distance in steps of 6 nm and number, which is twenty times as fast.
    """
    count = len(distance)
    if not FEWEST_AS_INTEGERS <= count < 1 << 24 or pair_class.max() >= 1 << 8:
        return np.lexsort((distance, pair_class))
    steps = (distance * ((2.0**32 - 1.0) / farthest_m)).astype(np.uint64)
    packed = (pair_class.astype(np.uint64) << np.uint64(56)) | (steps << np.uint64(24))
    packed |= np.arange(count, dtype=np.uint64)
    packed.sort()
    return (packed & np.uint64((1 << 24) - 1)).astype(np.int64)


def _corners(region: Region, camera: Camera) -> tuple[Array, Array]:
    """Return the corners (2,) of the floor where the camera can be, with an arm's length for how it is mounted."""
    arm = float(np.hypot(camera.mount.right_m, camera.mount.back_m)) + 0.5
    low, high = np.array([region.x_m, region.z_m]).T
    return low - arm, high + arm
