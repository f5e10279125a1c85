"""The landmark map: vertical edges of a building, where they stand and how well that is known; its index by place.

Lists of landmarks by piece of floor are kept with the map, so that looking for those near a pose costs the same however
large it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, Indices
from localiser.geometry.compiled import compiled

Kept = TypeVar("Kept")
FRAME = {"axes": "x right, y up, z backward", "units": "m"}
PIECE_M = 4.0
MOST_PIECES = 1 << 21  # of the floor; larger ones where a map has landmarks very far apart
_MARGIN_M = 4.0  # beyond the range: for cells of poses, and for a camera ahead of its robot


@dataclass(frozen=True, slots=True, eq=False)
class Quality:
    """How well landmarks (L) are known, besides their covariance; nan where something is not known.

    sightings: (L,) images that showed it. parallax_rad: (L,) widest angle between the directions it was seen from.
    existence: (L,) probability that it is there.
    """

    sightings: Array
    parallax_rad: Array
    existence: Array

    @classmethod
    def unknown(cls, count: int) -> Quality:
        """Return the quality of `count` landmarks of which nothing is known."""
        return cls(*np.full((3, count), np.nan))


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class LandmarkMap:
    """Vertical edges of a building, L of them, as columns; nan where something is not known.

    ids: L unique names. points: (L, 2) x, z in metres. cov: (L, 2, 2) m². bottom_m, top_m: (L,) heights above the
    floor between which the edge can be seen. polarity: (L,) as in `Edges`, seen from where it was measured, 0 unknown.
    source: how each was obtained. extra, header: unknown keys of each landmark and of the file, kept so that a newer
    version's file survives being saved. quality: how well each is known, None where the map does not say.
    """

    name: str
    ids: tuple[int | str, ...]
    points: Array
    cov: Array
    bottom_m: Array
    top_m: Array
    polarity: NDArray[np.int8]
    source: tuple[str, ...]
    frame: dict[str, Any] = field(default_factory=lambda: dict(FRAME))
    extra: tuple[dict[str, Any], ...] = ()
    header: dict[str, Any] = field(default_factory=dict)
    quality: Quality | None = None

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def from_points(
        cls,
        points: Array,
        *,
        name: str = "",
        ids: tuple[int | str, ...] | None = None,
        bottom_m: Array | None = None,
        top_m: Array | None = None,
        source: str = "",
    ) -> LandmarkMap:
        """Return a map of points (L, 2) with heights where given; the rest is unknown."""
        count = len(points)
        return cls(
            name=name,
            ids=tuple(range(count)) if ids is None else ids,
            points=np.asarray(points, dtype=np.float64).reshape(count, 2),
            cov=np.full((count, 2, 2), np.nan),
            bottom_m=np.full(count, np.nan) if bottom_m is None else bottom_m,
            top_m=np.full(count, np.nan) if top_m is None else top_m,
            polarity=np.zeros(count, dtype=np.int8),
            source=(source,) * count,
            extra=({},) * count,
        )

    def without_remarks(self) -> LandmarkMap:
        """Return the map without what nobody reads but people."""
        return replace(self, frame={}, extra=(), header={})

    # -- what several maps in one have, see `storage.Site`: a map is one alone

    @property
    def maps(self) -> tuple[LandmarkMap, ...]:
        """The maps that this one is laid together of: itself."""
        return (self,)

    def origin(self, map_name: str) -> Array:
        """Return where (3,) the frame of one of its maps lies."""
        return np.zeros(3)

    def map_at(self, point: Array) -> str:
        """Return the name of the map at a point, "" where there is but one."""
        return ""

    def is_on(self, map_name: str, points: Array) -> NDArray[np.bool_]:
        """Return which points (N, 2 or more) lie on a map."""
        return np.ones(len(points), dtype=bool)

    def seen_on(self, map_name: str) -> LandmarkMap:
        """Return all landmarks in the frame of one of its maps."""
        return self

    def sigma_m(self, unknown_m: float) -> Array:
        """Return the sigma (L,) of each position, the mean over directions; `unknown_m` where the map is silent."""
        trace = np.trace(self.cov, axis1=1, axis2=2)
        return np.where(np.isnan(trace), unknown_m, np.sqrt(np.maximum(trace, 0.0) / 2))

    def take(self, index: NDArray[np.int64]) -> LandmarkMap:
        """Return the map of the landmarks at `index` (K,), in that order."""
        arrays = ("points", "cov", "bottom_m", "top_m", "polarity")
        chosen: dict[str, Any] = {name: getattr(self, name)[index] for name in arrays}
        for name in ("ids", "source", "extra") if self.extra else ("ids", "source"):
            chosen[name] = tuple(getattr(self, name)[i] for i in index)
        quality = self.quality and Quality(*(getattr(self.quality, each.name)[index] for each in fields(Quality)))
        return replace(self, **chosen, quality=quality)


_OF_MAPS: WeakKeyDictionary[LandmarkMap, dict[tuple[Any, ...], Any]] = WeakKeyDictionary()


def kept_with(landmark_map: LandmarkMap, key: tuple[Any, ...], make: Callable[[], Kept]) -> Kept:
    """Return what `make()` returns, made once for a map and a key, and kept as long as the map is."""
    kept = _OF_MAPS.setdefault(landmark_map, {})
    if key not in kept:
        kept[key] = make()
    found: Kept = kept[key]
    return found


# -- by place ---------------------------------------------------------------------------------------------------------


class Reach(NamedTuple):
    """The floor in pieces (X, Z), and the landmarks within `radius_m` of any point of each.

    low: (2,) corner, per_m: pieces in a metre. start: (X·Z + 1,) and item: the list of piece k = x · Z + z is
    item[start[k] : start[k + 1]], ascending. Beyond the pieces there are none.
    """

    low: Array
    per_m: float
    shape: tuple[int, int]
    start: Indices
    item: NDArray[np.int32]
    radius_m: float

    @classmethod
    def of(cls, points: Array, radius_m: float) -> Reach:
        """Return the lists of landmarks (L, 2)."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        if not len(points):
            return cls(np.zeros(2), 0.0, (0, 0), np.zeros(1, np.int64), np.zeros(0, np.int32), radius_m)
        low, high = points.min(axis=0) - radius_m, points.max(axis=0) + radius_m
        piece_m = PIECE_M
        while np.prod(np.ceil((high - low) / piece_m)) > MOST_PIECES:
            piece_m *= 2.0
        columns, rows = np.maximum(np.ceil((high - low) / piece_m), 1).astype(np.int64).tolist()
        start, item = compiled(within_reach_loop)(points, low, piece_m, (columns, rows), radius_m)
        return cls(low, 1.0 / piece_m, (columns, rows), start, item, radius_m)


def reach_of(landmark_map: LandmarkMap, range_m: float) -> Reach:
    """Return which landmarks a camera may see that sees so far, from every piece of the floor."""
    radius_m = range_m + _MARGIN_M
    return kept_with(landmark_map, ("reach", range_m), lambda: Reach.of(landmark_map.points, radius_m))


def within_reach_loop(
    points: Array, low: Array, piece_m: float, shape: tuple[int, int], radius_m: float
) -> tuple[Indices, NDArray[np.int32]]:
    """Return start (X·Z + 1,) and item: the landmarks within a radius of any point of each piece of the floor."""
    columns, rows = shape
    start = np.zeros(columns * rows + 2, np.int64)
    item = np.empty(0, np.int32)
    for is_writing in (False, True):
        for k in range(len(points)):
            x, z = points[k, 0] - low[0], points[k, 1] - low[1]
            first, last = int((x - radius_m) / piece_m), int((x + radius_m) / piece_m)
            for i in range(max(first, 0), min(last, columns - 1) + 1):
                aside = max(i * piece_m - x, x - (i + 1) * piece_m, 0.0)
                left = np.sqrt(max(radius_m * radius_m - aside * aside, 0.0))
                begin, end = int((z - left) / piece_m), int((z + left) / piece_m)
                for j in range(max(begin, 0), min(end, rows - 1) + 1):
                    piece = i * rows + j
                    if is_writing:
                        item[start[piece + 1]] = k
                        start[piece + 1] += 1
                    else:
                        start[piece + 2] += 1
        if not is_writing:
            for piece in range(len(start) - 1):
                start[piece + 1] += start[piece]
            item = np.empty(start[len(start) - 1], np.int32)
    return start[:-1].copy(), item


def in_view_of_cells_loop(
    run: Indices,
    low: Array,
    per_unit: Array,
    shape: Indices,
    offset: tuple[float, float, float],
    points: Array,
    half_view_rad: float,
    farthest_m: float,
    reach: Reach,
) -> tuple[Indices, NDArray[np.int32]]:
    """Return start (cells + 1,) and item: landmarks item[start[c] : start[c + 1]] can be in view from cell c.

    run: (cells + 1,) ascending; cells that it does not grow by are left empty. Cells start at `low` (3,) x, z, heading,
    per_unit (3,) in a unit, shape (3,) in all. offset: of the camera from the poses that are meant: right, back (m),
    yaw (rad). points: (L, 2 or more) x, z. reach: of the same landmarks; where cells are larger than it is made for,
    all landmarks are looked at.

    Never one too few: what a camera sees lies between two planes through it and within range; for a whole cell the
    planes are moved apart by its half diagonal and turned by half its width in heading.
    """
    right, back, yaw = offset
    start, item = np.zeros(len(run), np.int64), np.empty(1024, np.int32)
    half_turn = 0.5 / per_unit[2]
    slack = 0.5 * np.hypot(1.0 / per_unit[0], 1.0 / per_unit[1]) + np.hypot(right, back) * half_turn
    sin_view, cos_view = np.sin(half_view_rad + half_turn), np.cos(half_view_rad + half_turn)
    is_wedge = half_view_rad + half_turn < np.pi / 2
    used, is_far = 0, farthest_m + slack > reach.radius_m
    for c in range(len(run) - 1):
        if run[c + 1] > run[c]:
            heading = low[2] + (c % shape[2] + 0.5) / per_unit[2]
            x = low[0] + (c // shape[2] // shape[1] + 0.5) / per_unit[0]
            z = low[1] + (c // shape[2] % shape[1] + 0.5) / per_unit[1]
            x += np.cos(heading) * right + np.sin(heading) * back
            z += np.cos(heading) * back - np.sin(heading) * right
            cos, sin = np.cos(heading + yaw), np.sin(heading + yaw)
            i, j = np.floor((x - reach.low[0]) * reach.per_m), np.floor((z - reach.low[1]) * reach.per_m)
            first, last = 0, len(points) if is_far else 0
            if not is_far and i >= 0 and j >= 0 and i < reach.shape[0] and j < reach.shape[1]:
                piece = int(i) * reach.shape[1] + int(j)
                first, last = reach.start[piece], reach.start[piece + 1]
            if used + last - first > len(item):
                item = np.concatenate((item, np.empty(len(item) + last - first, np.int32)))
            for place in range(first, last):
                k = place if is_far else reach.item[place]
                dx, dz = points[k, 0] - x, points[k, 1] - z
                aside, ahead = abs(dx * cos - dz * sin), -(dx * sin + dz * cos)
                inside = dx * dx + dz * dz <= (farthest_m + slack) ** 2
                if is_wedge:
                    inside = inside & (ahead * sin_view - aside * cos_view >= -slack)
                item[used] = k
                used += inside
        start[c + 1] = used
    return start, item[:used].copy()
