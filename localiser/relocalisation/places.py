"""The map prepared for global localisation: where the robot may be, and pairs of landmarks sorted by distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, SightParameters

Indices = NDArray[np.int64]

BOTTOM_STEP_M = 0.05  # landmarks whose lower ends differ by less are searched together
MANY_PAIRS = 400_000  # beyond which an image can try but a small part of what it may be
MOST_PAIRS = 5_000_000  # of landmarks in the table, 16 bytes each; about so many where there are more


@dataclass(frozen=True, slots=True)
class Region:
    """Where the robot may be before anything is seen: every point of a rectangle and every heading alike.

    x_m, z_m: lowest and highest coordinate.
    """

    x_m: tuple[float, float]
    z_m: tuple[float, float]

    @classmethod
    def around(cls, points: Array, margin_m: float) -> Region:
        """Return the rectangle around points (L, 2), wider by a margin on every side."""
        low, high = points.min(axis=0) - margin_m, points.max(axis=0) + margin_m
        return cls((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))

    @property
    def log_density(self) -> float:
        """Logarithm of the prior density inside, per m² rad."""
        area = (self.x_m[1] - self.x_m[0]) * (self.z_m[1] - self.z_m[0])
        return float(-np.log(area * 2 * np.pi))

    def contains(self, poses: Array) -> NDArray[np.bool_]:
        """Return which of the poses (N, 3) lie inside."""
        x, z = poses[:, 0], poses[:, 1]
        return np.asarray((x >= self.x_m[0]) & (x <= self.x_m[1]) & (z >= self.z_m[0]) & (z <= self.z_m[1]))

    def drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Return poses (count, 3) drawn evenly."""
        low, high = [self.x_m[0], self.z_m[0], -np.pi], [self.x_m[1], self.z_m[1], np.pi]
        return rng.uniform(low, high, (count, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Landmarks (L) of a map, and their ordered pairs (M) by distance.

    points: (L, 2) m. sigma_max_m: the largest error of a position. range_m: between which landmarks are seen. class_m:
    (B,) heights that lower ends are grouped to, ascending. pair: (M, 2) landmarks no farther apart than both can be in
    sight, sorted by `key` (M,), their distance plus a step for the group of the first times B plus that of the second.
    region: where the robot may be.
    """

    points: Array
    sigma_max_m: float
    range_m: tuple[float, float]
    class_m: Array
    pair: NDArray[np.int32]
    key: Array
    region: Region

    def __len__(self) -> int:
        return len(self.points)

    @property
    def are_many(self) -> bool:
        """Whether there are so many that an image can try but a part of what it may be."""
        return len(self.pair) > MANY_PAIRS

    @classmethod
    def of(
        cls,
        landmark_map: LandmarkMap,
        sight: SightParameters | None = None,
        region: Region | None = None,
        sigma_m: float = 0.01,
    ) -> Places:
        """Return the places of a map; sigma_m is the error of a landmark where the map is silent.

        sight: what is visible. region: where the robot may be, 1 m around the landmarks when not given.
        """
        sight, points = sight or SightParameters(), landmark_map.points
        bottom_m = np.nan_to_num(landmark_map.bottom_m, nan=0.0)  # the floor
        step, group = np.unique(np.round(bottom_m / BOTTOM_STEP_M).astype(np.int64), return_inverse=True)
        pair, distance = _pairs(points, 2 * sight.range_max_m)
        pair_class = group[pair[:, 0]] * len(step) + group[pair[:, 1]]
        key = pair_class * _key_step(sight.range_max_m) + distance
        order = np.argsort(key, kind="stable")
        return cls(
            points=points,
            sigma_max_m=float(landmark_map.sigma_m(sigma_m).max()),
            range_m=(sight.range_min_m, sight.range_max_m),
            class_m=step.astype(np.float64) * BOTTOM_STEP_M,
            pair=pair[order],
            key=key[order],
            region=region or Region.around(points, 1.0),
        )

    def pairs_between(self, pair_class: Indices, low_m: Array, high_m: Array) -> tuple[Indices, Indices]:
        """Return for queries (Q,) the slice first … last (Q,) of the pairs of this class at low_m … high_m (Q,)."""
        step = _key_step(self.range_m[1])
        first = np.searchsorted(self.key, pair_class * step + np.clip(low_m, 0.0, step - 1e-9))
        last = np.searchsorted(self.key, pair_class * step + np.clip(high_m, 0.0, step - 1e-9), side="right")
        return first, np.maximum(last, first)


def _key_step(range_max_m: float) -> float:
    """Return by how much the keys of one class of pairs lie above those of the class before: no distance reaches it."""
    return 2.0 * range_max_m + 1.0


def _pairs(points: Array, farthest_m: float) -> tuple[NDArray[np.int32], Array]:
    """Return the ordered pairs (M, 2) of landmarks at most so far apart, and how far (M,).

    Where they would be more than `MOST_PAIRS`, those that are farther apart than a landmark has that many neighbours.
    """
    from scipy.spatial import cKDTree

    tree, neighbours = cKDTree(points), MOST_PAIRS // len(points)
    if neighbours < len(points) - 1:
        farthest_m = min(farthest_m, float(np.median(tree.query(points, [neighbours + 1])[0])))
    one = tree.query_pairs(farthest_m, output_type="ndarray").astype(np.int32)
    distance = np.hypot(*(points[one[:, 0]] - points[one[:, 1]]).T)
    one, distance = one[distance > 1e-3], distance[distance > 1e-3]
    return np.concatenate([one, one[:, ::-1]]), np.concatenate([distance, distance])
