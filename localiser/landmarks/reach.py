"""Landmarks by place: for every piece of the floor, those near enough to be seen from it.

It is made once for a map and a range, and kept as long as the map is. So what looks for landmarks near a pose costs the
same however large the map is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.landmarks.landmark_map import LandmarkMap

Indices = NDArray[np.int64]

PIECE_M = 4.0
MOST_PIECES = 1 << 21  # of the floor; larger ones where a map has landmarks very far apart
_MARGIN_M = 4.0  # beyond the range: for cells of poses, and for a camera ahead of its robot


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """The floor in pieces (X, Z), and the landmarks within `radius_m` of any point of each.

    low: (2,) corner, per_m: pieces in a metre, 0 where one piece is the whole plane. start: (X·Z + 1,) and item: the
    list of piece k = x · Z + z is item[start[k] : start[k + 1]], ascending. Beyond the pieces there are none.
    """

    low: Array
    per_m: float
    shape: tuple[int, int]
    start: Indices
    item: NDArray[np.int32]
    radius_m: float

    @classmethod
    def of(cls, points: Array, radius_m: float) -> Reach:
        """Return the lists of landmarks (L, 2), L > 0."""
        from localiser.landmarks import index_kernel as kernel

        points = np.ascontiguousarray(points, dtype=np.float64)
        low, high = points.min(axis=0) - radius_m, points.max(axis=0) + radius_m
        piece_m = PIECE_M
        while np.prod(np.ceil((high - low) / piece_m)) > MOST_PIECES:
            piece_m *= 2.0
        columns, rows = np.maximum(np.ceil((high - low) / piece_m), 1).astype(np.int64).tolist()
        start, item = kernel.within_reach(points, low, piece_m, (columns, rows), radius_m)
        return cls(low, 1.0 / piece_m, (columns, rows), start, item, radius_m)

    @classmethod
    def everything(cls, count: int) -> Reach:
        """Return one list of all landmarks, for poses of which nothing is known."""
        start, item = np.array([0, count]), np.arange(count, dtype=np.int32)
        return cls(np.zeros(2), 0.0, (1, 1), start, item, np.inf)

    @property
    def arguments(self) -> tuple[Any, ...]:
        """What loops over it take."""
        return self.low, self.per_m, self.shape, self.start, self.item

    def beside(self, points: Array) -> Indices:
        """Return the landmarks, ascending, that may be within reach of any of the points (N, 2), and few others."""
        if self.per_m == 0.0:
            return self.item.astype(np.int64)
        place = np.floor((points - self.low) * self.per_m)
        inside = ((place >= 0) & (place < self.shape)).all(axis=1)
        x, z = place[inside].astype(np.int64).T
        pieces = np.unique(x * self.shape[1] + z)
        lists = [self.item[self.start[k] : self.start[k + 1]] for k in pieces.tolist()]
        if len(lists) == 1:
            return lists[0].astype(np.int64)
        return np.unique(np.concatenate([*lists, np.zeros(0, np.int32)])).astype(np.int64)


_OF_MAPS: WeakKeyDictionary[LandmarkMap, dict[tuple[Any, ...], Any]] = WeakKeyDictionary()


def kept_with(landmark_map: LandmarkMap, key: tuple[Any, ...], make: Any) -> Any:
    """Return what `make()` returns, made once for a map and a key, and kept as long as the map is."""
    kept = _OF_MAPS.setdefault(landmark_map, {})
    if key not in kept:
        kept[key] = make()
    return kept[key]


def reach_of(landmark_map: LandmarkMap, range_m: float) -> Reach:
    """Return which landmarks a camera may see that sees so far, from every piece of the floor."""
    if not len(landmark_map):
        return Reach.everything(0)

    def make() -> Reach:
        return Reach.of(landmark_map.points, range_m + _MARGIN_M)

    found: Reach = kept_with(landmark_map, ("reach", range_m), make)
    return found


def sigmas_m(landmark_map: LandmarkMap, unknown_m: float) -> Array:
    """Return what `LandmarkMap.sigma_m` does, (L,), worked out once."""
    found: Array = kept_with(landmark_map, ("sigma_m", unknown_m), lambda: landmark_map.sigma_m(unknown_m))
    return found
