"""Edit landmark maps by hand: add, remove and move landmarks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from localiser.errors import InputError
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.mapping.merge import joined_maps

BY_HAND = "by hand"


def index_of(landmark_map: LandmarkMap, name: str) -> int:
    """Return where the landmark with this id is. Raises InputError when there is none."""
    ids = [str(known) for known in landmark_map.ids]
    if name not in ids:
        some = ", ".join(ids[:8]) + (", …" if len(ids) > 8 else "")
        raise InputError(f"expected the id of a landmark ({some}), found {name!r}", field="ID")
    return ids.index(name)


def added(
    landmark_map: LandmarkMap, point: Array, name: str | None, bottom_m: float | None, top_m: float | None
) -> LandmarkMap:
    """Return the map with one landmark more at (2,) x, z; its id is the next number if no name is given.

    Raises InputError when the name is taken or the top below the bottom.
    """
    if name is not None and name in {str(known) for known in landmark_map.ids}:
        raise InputError(f"expected an id of its own, found {name!r}, which the map has already", field="--id")
    if bottom_m is not None and top_m is not None and top_m < bottom_m:
        raise InputError(f"expected a top above the bottom at {bottom_m}, found {top_m}", field="--top")
    number = 1 + max((known for known in landmark_map.ids if isinstance(known, int)), default=-1)
    landmark = LandmarkMap.from_points(
        point[None],
        ids=(number if name is None else int(name) if name.isdecimal() else name,),
        bottom_m=np.array([np.nan if bottom_m is None else bottom_m]),
        top_m=np.array([np.nan if top_m is None else top_m]),
        source=BY_HAND,
    )
    return joined_maps(landmark_map, landmark)


def removed(landmark_map: LandmarkMap, names: list[str]) -> LandmarkMap:
    """Return the map without the landmarks of these ids. Raises InputError for an unknown one, or if none is left."""
    gone = {index_of(landmark_map, name) for name in names}
    if len(gone) == len(landmark_map):
        raise InputError("expected a map that keeps a landmark, found none left", field="ID")
    return landmark_map.take(np.array([k for k in range(len(landmark_map)) if k not in gone]))


def moved(landmark_map: LandmarkMap, name: str, point: Array) -> LandmarkMap:
    """Return the map with one landmark at (2,) x, z; how sure its place was no longer holds. Raises InputError."""
    index = index_of(landmark_map, name)
    points, cov = landmark_map.points.copy(), landmark_map.cov.copy()
    points[index], cov[index] = point, np.nan
    source = list(landmark_map.source)
    source[index] = f"{source[index]}; moved {BY_HAND}".strip("; ")
    return replace(landmark_map, points=points, cov=cov, source=tuple(source))
