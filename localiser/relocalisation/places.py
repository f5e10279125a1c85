"""The map prepared for global localisation: landmarks with ends, and their pairs sorted by distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.geometry import Array
from localiser.landmarks import LandmarkIndex, LandmarkMap, SightParameters, half_view_rad
from localiser.relocalisation.mixture import Region

Indices = NDArray[np.int64]

BOTTOM_STEP_M = 0.05  # landmarks whose lower ends differ by less are searched together
ENDLESS_M = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Landmarks (L) of a map, and their ordered pairs (M) by distance.

    points: (L, 2) m. bottom_m, top_m: (L,) with what the map does not know taken as floor and as endless. sigma_m: (L,)
    of each position. sight: what counts as visible. class_m: (B,) heights that lower ends are grouped to, ascending.
    pair: (M, 2) landmarks no farther apart than both can be in sight, sorted by `pair_class` (M,), the group of the
    first times B plus that of the second, and then by `pair_m` (M,), their distance. region: where the robot may be.
    index: which landmarks can be in view from where in it.
    """

    points: Array
    bottom_m: Array
    top_m: Array
    sigma_m: Array
    sight: SightParameters
    class_m: Array
    pair: Indices
    pair_class: Indices
    pair_m: Array
    region: Region
    index: LandmarkIndex

    def __len__(self) -> int:
        return len(self.points)

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
        distance = np.hypot(*(points[:, None] - points[None, :]).T).T
        first, second = np.nonzero((distance > 1e-3) & (distance <= 2 * sight.range_max_m))
        pair_class = group.ravel()[first] * len(step) + group.ravel()[second]
        pair_m = distance[first, second]
        order = np.lexsort((pair_m, pair_class))
        return cls(
            points=points,
            bottom_m=bottom_m,
            top_m=top_m,
            sigma_m=landmark_map.sigma_m(sigma_m),
            sight=sight,
            class_m=step.astype(np.float64) * BOTTOM_STEP_M,
            pair=np.stack([first, second], axis=-1)[order],
            pair_class=pair_class[order],
            pair_m=pair_m[order],
            region=region,
            index=LandmarkIndex.of(points, *_corners(region, camera), half_view_rad(camera), sight.range_max_m),
        )

    def pairs_between(self, pair_class: Indices, low_m: Array, high_m: Array) -> tuple[Indices, Indices]:
        """Return for queries (Q,) the slice first … last (Q,) of the pairs of this class at low_m … high_m (Q,)."""
        # One ascending key for class and distance: no distance reaches the step between classes.
        step = 2.0 * self.sight.range_max_m + 1.0
        key = self.pair_class * step + self.pair_m
        first = np.searchsorted(key, pair_class * step + np.clip(low_m, 0.0, step - 1e-9))
        last = np.searchsorted(key, pair_class * step + np.clip(high_m, 0.0, step - 1e-9), side="right")
        return first, np.maximum(last, first)


def _corners(region: Region, camera: Camera) -> tuple[Array, Array]:
    """Return the corners (2,) of the floor where the camera can be, with an arm's length for how it is mounted."""
    arm = float(np.hypot(camera.mount.right_m, camera.mount.back_m)) + 0.5
    low, high = np.array([region.x_m, region.z_m]).T
    return low - arm, high + arm
