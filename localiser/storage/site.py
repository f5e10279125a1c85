"""Several maps, such as the floors of a building, laid apart in one, so that they compete as places of one map do.

The first keeps its coordinates, each other stands beside the one before. A robot on one map never has landmarks of
another in sight, and a lift is a robot that is carried.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from localiser.errors import InputError
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap

GAP_M = 60.0  # between two maps: farther than a camera sees from 10 m outside one of them


@dataclass(frozen=True, slots=True, eq=False)
class Site(LandmarkMap):
    """All landmarks of several maps as one map, and the M maps themselves.

    ids: `map/id`. laid: the maps in their own frames, each with a name of its own. origins: (M, 2) where the origin of
    each frame lies in this map.
    """

    laid: tuple[LandmarkMap, ...] = ()
    origins: Array = field(default_factory=lambda: np.zeros((0, 2)))

    @classmethod
    def beside(cls, maps: Sequence[LandmarkMap], name: str = "") -> Site:
        """Return the maps laid apart. Raises InputError where two have the same name, or one has none."""
        names = Counter(re.sub("[^A-Za-z0-9_]", "_", one.name) for one in maps)  # as their frames are called
        if unfit := [one for one, count in names.items() if count > 1 or not one]:
            raise InputError(
                f"expected maps with a name of their own, found {unfit[0]!r} {names[unfit[0]]}×", field="maps"
            )
        origins, edge = np.zeros((len(maps), 2)), float(maps[0].points[:, 0].max())
        for k, one in enumerate(maps[1:], 1):
            low, high = one.points.min(axis=0), one.points.max(axis=0)
            # Whole metres: a pose is the same number in either frame but for its last bits.
            origins[k] = np.ceil(edge + GAP_M - low[0]), np.round(maps[0].points[:, 1].min() - low[1])
            edge = float(high[0] + origins[k, 0])
        of = np.repeat(np.arange(len(maps)), [len(one) for one in maps])

        def joined(column: str) -> Array:
            return np.concatenate([getattr(one, column) for one in maps])

        return cls(
            name=name or " + ".join(one.name for one in maps),
            ids=tuple(f"{one.name}/{landmark}" for one in maps for landmark in one.ids),
            points=joined("points") + origins[of],
            cov=joined("cov"),
            bottom_m=joined("bottom_m"),
            top_m=joined("top_m"),
            polarity=joined("polarity").astype(np.int8),
            source=tuple(source for one in maps for source in one.source),
            extra=tuple(one for each in maps for one in (each.extra or ({},) * len(each))),
            laid=tuple(maps),
            origins=origins,
        )

    @property
    def maps(self) -> tuple[LandmarkMap, ...]:
        """The maps, each in its own frame."""
        return self.laid

    def origin(self, map_name: str) -> Array:
        """Return where (3,) the frame of the map with this name lies; none is turned. Raises InputError."""
        return np.append(self.origins[self._number(map_name)], 0.0)

    def map_at(self, point: Array) -> str:
        """Return the name of the map that a point (2 or more,) of this one lies on, or beside."""
        return self.laid[int(self._nearest(point[None, :2])[0])].name

    def is_on(self, map_name: str, points: Array) -> NDArray[np.bool_]:
        """Return which points (N, 2 or more) in a map's own frame lie on it, and not on another one."""
        number = self._number(map_name)
        return np.asarray(self._nearest(points[:, :2] + self.origins[number]) == number)

    def seen_on(self, map_name: str) -> LandmarkMap:
        """Return all landmarks as a plain map in the frame of one map; those of others are far away."""
        points = self.points - self.origin(map_name)[:2]
        columns = self.cov, self.bottom_m, self.top_m, self.polarity, self.source
        return LandmarkMap(self.name, self.ids, points, *columns)

    def without_remarks(self) -> LandmarkMap:
        """Return all landmarks as a plain map without what nobody reads but people."""
        return replace(self.seen_on(""), frame={})

    def _number(self, map_name: str) -> int:
        for number, one in enumerate(self.laid):
            if map_name in (one.name, ""):
                return number
        names = ", ".join(one.name for one in self.laid)
        raise InputError(f"expected one of {names}, found {map_name!r}", field="map")

    def _nearest(self, points: Array) -> NDArray[np.int64]:
        """Return the map (N,) whose rectangle around all landmarks is nearest to points (N, 2) of this one."""
        distances = []
        for one, origin in zip(self.laid, self.origins, strict=True):
            low, high = one.points.min(axis=0) + origin, one.points.max(axis=0) + origin
            distances.append(np.hypot(*np.maximum(np.maximum(low - points, points - high), 0.0).T))
        return np.asarray(np.argmin(distances, axis=0))
