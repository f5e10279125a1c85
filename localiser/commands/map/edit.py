"""Edit landmark maps by hand, and write them as tables."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np

from localiser.errors import InputError
from localiser.landmarks import LandmarkMap
from localiser.mapping import joined_maps

BY_HAND = "by hand"
_FARTHEST_M = 1e6


def parse_point(text: str, field: str) -> np.ndarray:
    """Return the point (2,) that `x,z` in metres stands for. Raises InputError."""
    try:
        point = np.array([float(part) for part in text.split(",")])
    except ValueError:
        point = np.zeros(0)
    if point.shape != (2,) or not (np.abs(point) <= _FARTHEST_M).all():
        raise InputError(f"expected x,z in metres, found {text!r}", field=field)
    return point


def index_of(landmark_map: LandmarkMap, name: str) -> int:
    """Return where the landmark with this id is. Raises InputError when there is none."""
    ids = [str(known) for known in landmark_map.ids]
    if name not in ids:
        some = ", ".join(ids[:8]) + (", …" if len(ids) > 8 else "")
        raise InputError(f"expected the id of a landmark ({some}), found {name!r}", field="ID")
    return ids.index(name)


def added(
    landmark_map: LandmarkMap, point: np.ndarray, name: str | None, bottom_m: float | None, top_m: float | None
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


def moved(landmark_map: LandmarkMap, name: str, point: np.ndarray) -> LandmarkMap:
    """Return the map with one landmark at (2,) x, z; how sure its place was no longer holds. Raises InputError."""
    index = index_of(landmark_map, name)
    points, cov = landmark_map.points.copy(), landmark_map.cov.copy()
    points[index], cov[index] = point, np.nan
    source = list(landmark_map.source)
    source[index] = f"{source[index]}; moved {BY_HAND}".strip("; ")
    return replace(landmark_map, points=points, cov=cov, source=tuple(source))


def table(landmark_map: LandmarkMap) -> str:
    """Return the map as CSV, one landmark a row, empty cells where something is not known."""
    quality = landmark_map.quality
    unknown = np.full(len(landmark_map), np.nan)
    columns = {
        "x": landmark_map.points[:, 0],
        "z": landmark_map.points[:, 1],
        "cov_xx": landmark_map.cov[:, 0, 0],
        "cov_xz": landmark_map.cov[:, 0, 1],
        "cov_zz": landmark_map.cov[:, 1, 1],
        "bottom_m": landmark_map.bottom_m,
        "top_m": landmark_map.top_m,
        "polarity": np.where(landmark_map.polarity == 0, np.nan, landmark_map.polarity),
        "sightings": quality.sightings if quality else unknown,
        "parallax_deg": np.rad2deg(quality.parallax_rad) if quality else unknown,
        "existence": quality.existence if quality else unknown,
    }
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["id", *columns, "source"])
    for index, (name, source) in enumerate(zip(landmark_map.ids, landmark_map.source, strict=True)):
        cells = ("" if np.isnan(column[index]) else f"{column[index]:.9g}" for column in columns.values())
        writer.writerow([name, *cells, source])
    return text.getvalue()
