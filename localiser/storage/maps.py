"""Read and write landmark maps as YAML. Keys that a newer version added to a file are kept and written back.

A site is a list of maps, each in a file beside it or written out in the list itself.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, StrictInt, StrictStr, model_validator

from localiser.documents import Document, dump, is_name, parse, plain_name, read_text, shown, validate, write_text
from localiser.errors import InputError
from localiser.geometry import Array
from localiser.landmarks import FRAME, LandmarkMap, Quality
from localiser.markers import code_of
from localiser.storage.cameras import FileModel
from localiser.storage.files import MAP, inside, refuse_other

FORMAT = "localiser-map/1"
SITE_FORMAT = "localiser-site/1"
MOST_MAPS = 100  # of a site
MOST_BYTES = 64 * 2**20
MOST_LANDMARKS = 100_000  # as many as are measured in docs/results.md

Metres = Annotated[float, Field(ge=-1e8, le=1e8)]
Variance = Annotated[float, Field(ge=0, le=1e12)]
Open = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False)


class CovFile(BaseModel):
    """Covariance of a landmark's position, m²."""

    model_config = FileModel

    xx: Variance
    xz: Annotated[float, Field(ge=-1e12, le=1e12)]
    zz: Variance

    @model_validator(mode="after")
    def _positive(self) -> CovFile:
        if self.xz**2 > self.xx * self.zz:
            raise ValueError("expected a covariance with xz² ≤ xx·zz")
        return self


class LandmarkFile(BaseModel):
    """One landmark; keys that are not known here are kept."""

    model_config = Open

    id: StrictInt | Annotated[StrictStr, is_name]
    x: Metres
    z: Metres
    cov: CovFile | None = None
    bottom_m: Metres = math.nan
    top_m: Metres = math.nan
    polarity: Literal[-1, 1] | None = None
    source: Annotated[str, Field(min_length=1), is_name] = ""
    sightings: Annotated[int, Field(ge=0)] | None = None
    parallax_deg: Annotated[float, Field(ge=0, le=360)] = math.nan
    existence: Annotated[float, Field(ge=0, le=1)] = math.nan


class PoseFile(BaseModel):
    """A pose in a map's frame, as large as UTM has them."""

    model_config = FileModel

    x: Metres
    z: Metres
    heading_deg: Annotated[float, Field(ge=-360, le=360)]


class DriveFile(BaseModel):
    """The drive that a map was built from: what it is known by, and where it began."""

    model_config = FileModel

    log: str
    first_image_ns: StrictInt
    last_image_ns: StrictInt
    odometry_m: Annotated[float, Field(ge=0)]
    start: PoseFile


class MapFile(BaseModel):
    """A map file; keys that are not known here are kept."""

    model_config = Open

    format: Literal["localiser-map/1"]
    landmarks: Annotated[list[LandmarkFile], Field(min_length=1, max_length=MOST_LANDMARKS)]
    name: Annotated[str, is_name] = ""
    frame: dict[str, Any] = Field(default_factory=lambda: dict(FRAME))
    drive: DriveFile | None = None


class SiteFile(BaseModel):
    """The file of a site: its maps, as names of files beside it or written out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal["localiser-site/1"]
    maps: Annotated[list[Annotated[str, is_name] | dict[str, Any]], Field(min_length=1, max_length=MOST_MAPS)]
    name: Annotated[str, is_name] = ""


def read_maps(paths: Sequence[Path]) -> LandmarkMap:
    """Return the map of a file, or several laid apart in one, each named as its file is. Raises InputError."""
    if len(paths) == 1:
        return read_map(paths[0])
    return Site.beside([_map_of_site(path) for path in paths])


def _map_of_site(path: Path) -> LandmarkMap:
    return replace(_one_map(_document_of(path)), name=plain_name(path.stem))


def read_map(path: Path | str) -> LandmarkMap:
    """Return the map that a file describes, or the maps of a site laid apart in one. Raises InputError."""
    return map_from_document(_document_of(Path(path)), Path(path).parent)


def _document_of(path: Path) -> Document:
    refuse_other(path, MAP)
    return parse(read_text(path, MOST_BYTES), str(path))


def map_from_document(document: Document, folder: Path | None = None) -> LandmarkMap:
    """Return the map that a document describes, or those of a site. folder: where its files are. Raises InputError."""
    return _site_of(document, folder) if _is_site(document) else _one_map(document)


def _one_map(document: Document) -> LandmarkMap:
    """Return the map that a document describes; a list of maps is refused."""
    if _is_site(document):
        raise document.error(("format",), f"expected {FORMAT!r}, found a list of maps")
    file = validate(document, MapFile)
    _check_frame(document, file.frame)
    _check_landmarks(document, file.landmarks)
    landmarks = file.landmarks
    return LandmarkMap(
        name=file.name,
        ids=tuple(landmark.id for landmark in landmarks),
        points=np.array([[landmark.x, landmark.z] for landmark in landmarks]),
        cov=np.array([_cov(landmark.cov) for landmark in landmarks]),
        bottom_m=_column(landmarks, "bottom_m"),
        top_m=_column(landmarks, "top_m"),
        polarity=np.array([landmark.polarity or 0 for landmark in landmarks], dtype=np.int8),
        source=tuple(landmark.source for landmark in landmarks),
        frame=file.frame,
        extra=tuple(dict(landmark.model_extra or {}) for landmark in landmarks),
        header=dict(file.model_extra or {}) | ({"drive": file.drive.model_dump()} if file.drive else {}),
        quality=_quality(landmarks),
    )


def _is_site(document: Document) -> bool:
    return isinstance(document.value, dict) and document.value.get("format") == SITE_FORMAT


def _site_of(document: Document, folder: Path | None) -> Site:
    """Return the maps that a site's document lists, laid apart."""
    file, maps = validate(document, SiteFile), []
    for number, one in enumerate(file.maps):
        key = ("maps", number)
        if isinstance(one, dict):
            places = {rest[2:]: place for rest, place in document.places.items() if rest[:2] == key}
            if _is_site(part := Document(one, places)):
                raise document.error((*key, "format"), f"expected {FORMAT!r}, found a list of maps")
            maps.append(_one_map(part))
            continue
        try:
            if folder is None:
                raise ValueError("expected a map that is written out")
            maps.append(_map_of_site(inside(folder, one)))
        except ValueError as error:
            raise document.error(key, f"{error}, found {shown(one)}") from None
    try:
        return Site.beside(maps, file.name)
    except InputError as error:
        raise document.error(("maps",), error.problem) from None


def _column(landmarks: list[LandmarkFile], name: str) -> Array:
    return np.array([getattr(landmark, name) for landmark in landmarks], dtype=np.float64)


def _quality(landmarks: list[LandmarkFile]) -> Quality | None:
    """Return what the landmarks say of their quality, None where none says anything."""
    sightings, existence = _column(landmarks, "sightings"), _column(landmarks, "existence")
    quality = Quality(sightings, np.deg2rad(_column(landmarks, "parallax_deg")), existence)
    known = any(np.isfinite(column).any() for column in (sightings, existence, quality.parallax_rad))
    return quality if known else None


def _check_frame(document: Document, frame: dict[str, Any]) -> None:
    """Refuse a map in other axes or units: it would be read as if it were in ours."""
    for name, ours in FRAME.items():
        if frame.get(name, ours) != ours:
            raise document.error(("frame", name), f"expected {ours!r}, found {shown(frame[name])}")


def _check_landmarks(document: Document, landmarks: list[LandmarkFile]) -> None:
    first: dict[str, int] = {}
    for index, landmark in enumerate(landmarks):
        # 7 and "7" would be the same name in a table.
        other = first.setdefault(str(landmark.id), index)
        if other != index:
            line = document.place(("landmarks", other, "id")).line
            raise document.error(
                ("landmarks", index, "id"), f"expected an id of its own, found {landmark.id!r} as in line {line}"
            )
        if (identity := (landmark.model_extra or {}).get("identity")) is not None:
            try:
                code_of(identity)
            except InputError as error:
                raise document.error(("landmarks", index, "identity"), error.problem) from None
        if landmark.top_m < landmark.bottom_m:
            raise document.error(
                ("landmarks", index, "top_m"),
                f"expected a top above the bottom at {landmark.bottom_m}, found {landmark.top_m}",
            )


def _cov(cov: CovFile | None) -> list[list[float]]:
    return [[math.nan] * 2] * 2 if cov is None else [[cov.xx, cov.xz], [cov.xz, cov.zz]]


def write_map(landmark_map: LandmarkMap, path: Path | str) -> None:
    """Write a map file with everything that the map knows. Raises OutputError."""
    write_text(Path(path), map_text(landmark_map))


def map_text(landmark_map: LandmarkMap) -> str:
    """Return the text of the map's file."""
    return dump(map_data(landmark_map))


def map_data(landmark_map: LandmarkMap) -> dict[str, Any]:
    """Return the map as plain data, as its file has it; what is unknown is left out. Maps of a site are written out."""
    if isinstance(landmark_map, Site):
        return {"format": SITE_FORMAT, "name": landmark_map.name, "maps": [map_data(one) for one in landmark_map.maps]}
    return {
        "format": FORMAT,
        "name": landmark_map.name,
        "frame": dict(landmark_map.frame),
        **landmark_map.header,
        "landmarks": [_landmark_data(landmark_map, index) for index in range(len(landmark_map))],
    }


def _landmark_data(landmark_map: LandmarkMap, index: int) -> dict[str, Any]:
    x, z = landmark_map.points[index]
    (xx, xz), (_, zz) = landmark_map.cov[index]
    if xz**2 > xx * zz:  # by rounding
        xz = math.copysign(math.sqrt(max(xx * zz, 0.0)) * (1 - 1e-12), xz)
    data: dict[str, Any] = {
        "id": landmark_map.ids[index],
        "x": float(x),
        "z": float(z),
        "cov": None if np.isnan([xx, xz, zz]).all() else {"xx": float(xx), "xz": float(xz), "zz": float(zz)},
        "bottom_m": _known(landmark_map.bottom_m[index]),
        "top_m": _known(landmark_map.top_m[index]),
        "polarity": int(landmark_map.polarity[index]) or None,
        "source": landmark_map.source[index] or None,
    }
    if (quality := landmark_map.quality) is not None:
        count = _known(quality.sightings[index])
        data["sightings"] = None if count is None else int(count)
        data["parallax_deg"] = _known(round(math.degrees(quality.parallax_rad[index]), 6))
        data["existence"] = _known(round(float(quality.existence[index]), 6))
    known = {key: value for key, value in data.items() if value is not None}
    return known | (landmark_map.extra[index] if landmark_map.extra else {})


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


# -- several maps, such as the floors of a building, laid apart in one, so that they compete as places of one map do ---
#
# The first keeps its coordinates, each other stands beside the one before. A robot on one map never has landmarks of
# another in sight, and a lift is a robot that is carried.

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

        def of_all(column: str) -> Array:
            return np.concatenate([getattr(one, column) for one in maps])

        return cls(
            name=name or " + ".join(one.name for one in maps),
            ids=tuple(f"{one.name}/{landmark}" for one in maps for landmark in one.ids),
            points=of_all("points") + origins[of],
            cov=of_all("cov"),
            bottom_m=of_all("bottom_m"),
            top_m=of_all("top_m"),
            polarity=of_all("polarity").astype(np.int8),
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
