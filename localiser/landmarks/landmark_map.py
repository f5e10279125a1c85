"""The landmark map: vertical edges of a building, where they stand and how well that is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array

Kept = TypeVar("Kept")
FRAME = {"axes": "x right, y up, z backward", "units": "m"}


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
        nothing = np.full(count, np.nan)
        return cls(nothing, nothing, nothing)

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> Quality:
        """Return the quality of the landmarks at `index`."""
        return Quality(self.sightings[index], self.parallax_rad[index], self.existence[index])


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

        def make() -> Array:
            trace = np.trace(self.cov, axis1=1, axis2=2)
            return np.where(np.isnan(trace), unknown_m, np.sqrt(np.maximum(trace, 0.0) / 2))

        return kept_with(self, ("sigma_m", unknown_m), make)

    def take(self, index: NDArray[np.int64]) -> LandmarkMap:
        """Return the map of the landmarks at `index` (K,), in that order."""
        arrays = ("points", "cov", "bottom_m", "top_m", "polarity")
        chosen: dict[str, Any] = {name: getattr(self, name)[index] for name in arrays}
        for name in ("ids", "source", "extra") if self.extra else ("ids", "source"):
            chosen[name] = tuple(getattr(self, name)[i] for i in index)
        return replace(self, **chosen, quality=self.quality and self.quality.take(index))


_OF_MAPS: WeakKeyDictionary[LandmarkMap, dict[tuple[Any, ...], Any]] = WeakKeyDictionary()


def kept_with(landmark_map: LandmarkMap, key: tuple[Any, ...], make: Callable[[], Kept]) -> Kept:
    """Return what `make()` returns, made once for a map and a key, and kept as long as the map is."""
    kept = _OF_MAPS.setdefault(landmark_map, {})
    if key not in kept:
        kept[key] = make()
    found: Kept = kept[key]
    return found
