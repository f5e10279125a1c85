"""The UTIAS multi-robot data set: real robots that see 15 cylinders, each with a barcode, by bearing and range.

Leung, Halpern, Barfoot, Liu, "The UTIAS multi-robot cooperative localization and mapping dataset", IJRR 30(8), 2011.
A log is one robot of a data set, `FOLDER:1`. Only bearings are used; barcodes say which landmark was seen, which the
filter does not look at. What is no landmark, another robot or a barcode that was misread, stays in as clutter.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from localiser import geometry, mcl
from localiser.documents import read_text, shown
from localiser.edges import Edges
from localiser.edges.bearings import BearingSensor, complete
from localiser.errors import InputError
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.storage.log import Log
from localiser.storage.tables import MAX_TABLE_BYTES, integer, number
from localiser.storage.trajectories import nanoseconds

ODOMETRY_QUALITY = {"motion.alpha1": 0.01, "motion.alpha2": 0.01, "motion.alpha3": 0.01, "motion.alpha4": 0.001}
"""Velocities are as commanded, not as driven: off by up to a tenth, and the heading by some degrees every 2 s."""


@dataclass(frozen=True, slots=True)
class MrclamReader:
    """Reads one robot of a data set; sensor: what stands in for the camera."""

    sensor: BearingSensor = field(default_factory=BearingSensor)

    @property
    def format(self) -> str:
        """The name of the format."""
        return "mrclam"

    def recognises(self, path: Path) -> bool:
        """Whether `path` is FOLDER:N with the files of robot N, or a folder with those of any robot."""
        folder, robot = _split(path)
        return (folder / f"Robot{robot or 1}_Odometry.dat").exists()

    def read(self, path: Path) -> Log:
        """Return the log of one robot. Raises InputError."""
        folder, robot = _split(path)
        if robot is None:
            raise InputError(f"expected a robot's number, as in {path}:1, found none", path=path)
        if not folder.is_dir():
            raise InputError("no such folder", path=folder)
        odometry = _odometry(folder / f"Robot{robot}_Odometry.dat")
        truth = _groundtruth(folder / f"Robot{robot}_Groundtruth.dat")
        landmark_map = _landmarks(folder / "Landmark_Groundtruth.dat")
        sightings = _sightings(folder, robot, landmark_map, self.sensor)
        # Without truth a frame cannot be judged, without odometry not be located.
        frames = [frame for frame in sightings if odometry.covers(frame.t_ns) and truth.covers(frame.t_ns)]
        if not frames:
            raise InputError(
                "expected measurements while there is odometry and truth, found none",
                path=folder / f"Robot{robot}_Measurement.dat",
            )
        name = f"{folder.resolve().name}-robot{robot}"
        return Log(
            name=name,
            path=folder,
            camera=self.sensor.camera(name),
            odometry=odometry,
            frames=frames,
            landmark_map=landmark_map,
            groundtruth=truth,
            settings=ODOMETRY_QUALITY,
        )


def _split(path: Path) -> tuple[Path, int | None]:
    """Return folder and number of `FOLDER:N`; no number where there is none."""
    found = re.fullmatch(r"(.+):(\d{1,3})", str(path), re.ASCII)
    return (Path(found[1]), int(found[2])) if found else (path, None)


# -- what the robot did and saw ---------------------------------------------------------------------------------------


def integrated(t_ns: NDArray[np.int64], forward_m_s: Array, turn_rad_s: Array) -> Trajectory:
    """Return the poses (T, 3) at the times (T,) of a robot that starts at 0 and holds each command until the next.

    forward_m_s, turn_rad_s: (T,) commands, the turn anticlockwise. Between two times the robot drives an exact arc; its
    chord is v·dt·sin(w·dt/2)/(w·dt/2) long and points along the heading half-way.
    """
    seconds = np.diff(t_ns) / 1e9
    turn = turn_rad_s[:-1] * seconds
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    chord = forward_m_s[:-1] * seconds * np.sinc(turn / (2 * np.pi))
    steps = chord[:, None] * geometry.forward(heading[:-1] + turn / 2)
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return Trajectory(t_ns, np.column_stack([points, geometry.wrap_angle(heading)]))


def _odometry(path: Path) -> Trajectory:
    rows = _rows(path, "time", "forward velocity", "angular velocity")
    _require_time_order(path, rows, strictly=False)
    # Of several commands at one time only the last is ever driven.
    driven = [row for row, later in pairwise(rows) if row.values[0] != later.values[0]] + rows[-1:]
    return integrated(_times(driven), *np.array([row.values[1:] for row in driven]).T)


def _groundtruth(path: Path) -> Trajectory:
    rows = _rows(path, "time", "x", "y", "orientation")
    _require_time_order(path, rows, strictly=True)
    return Trajectory(_times(rows), geometry.pose_from_ros(np.array([row.values[1:] for row in rows])))


def _landmarks(path: Path) -> LandmarkMap:
    """Return the map, in the order of the file; ids are the numbers of the subjects."""
    rows = _rows(path, "subject", "x", "y", "x std-dev", "y std-dev")
    ids = tuple(int(row.values[0]) for row in rows)
    for row, number_of in zip(rows, ids, strict=True):
        if ids.count(number_of) > 1:
            raise InputError(f"landmark {number_of} given twice", path=path, line=row.line, field="subject")
    values = np.array([row.values[1:] for row in rows])
    points = values[:, :2] * [1.0, -1.0]
    landmark_map = LandmarkMap.from_points(points, name=path.parent.name, ids=ids, source="motion capture")
    return replace(landmark_map, cov=values[:, 2:, None] ** 2 * np.eye(2))


def _sightings(folder: Path, robot: int, landmark_map: LandmarkMap, sensor: BearingSensor) -> Iterator[mcl.Sighting]:
    """Yield the bearings of each time as one frame; other robots and unknown barcodes have the landmark id -1."""
    path = folder / f"Robot{robot}_Measurement.dat"
    rows = _rows(path, "time", "barcode", "range", "bearing")
    _require_time_order(path, rows, strictly=False)
    subjects = {row.values[1]: row.values[0] for row in _rows(folder / "Barcodes.dat", "subject", "barcode")}
    index = {subject: place for place, subject in enumerate(landmark_map.ids)}
    for row in rows:
        if abs(row.values[3]) >= np.pi / 2:
            problem = f"expected a bearing within ±π/2, found {row.values[3]}"
            raise InputError(problem, path=path, line=row.line, field="bearing")
    sigma, tilt = math.radians(sensor.bearing_sigma_deg), math.radians(sensor.tilt_deg)
    for t_ns, frame in groupby(rows, key=lambda row: int(row.values[0])):
        seen = list(frame)
        bearing = np.array([-row.values[3] for row in seen])  # positive to the left in the file
        unknown = np.full(len(seen), np.nan)
        landmark = [index.get(int(subjects.get(row.values[1], 0)), -1) for row in seen]
        measured = complete(bearing, np.full(len(seen), sigma), unknown, unknown, tilt)
        yield mcl.Sighting(t_ns, Edges.from_columns(*measured, landmark_id=np.array(landmark, dtype=np.int64)))


# -- files: white space between columns, # before comments ------------------------------------------------------------


class _Row(NamedTuple):
    """One row of a table: its line in the file, and its values, a time being integer nanoseconds."""

    line: int
    values: list[Any]


def _rows(path: Path, *names: str) -> list[_Row]:
    """Return the rows, at least one, of a table whose columns are `names`."""
    rows = []
    for line, content in enumerate(read_text(path, MAX_TABLE_BYTES).split("\n"), start=1):
        cells = content.split()
        if not cells or cells[0].startswith("#"):
            continue
        if len(cells) != len(names):
            wanted = f"{len(names)} columns ({', '.join(names)})"
            raise InputError(f"expected {wanted}, found {len(cells)}", path=path, line=line)
        rows.append(_Row(line, [_cell(path, line, name, cell) for name, cell in zip(names, cells, strict=True)]))
    if not rows:
        raise InputError("expected at least one row, found none", path=path)
    return rows


def _cell(path: Path, line: int, name: str, cell: str) -> float:
    read = {"time": nanoseconds, "subject": integer, "barcode": integer}.get(name, number)
    try:
        return read(cell)
    except ValueError as error:
        raise InputError(f"expected {error}, found {shown(cell)}", path=path, line=line, field=name) from None


def _times(rows: list[_Row]) -> NDArray[np.int64]:
    return np.array([row.values[0] for row in rows], dtype=np.int64)


def _require_time_order(path: Path, rows: list[_Row], *, strictly: bool) -> None:
    for earlier, later in pairwise(rows):
        step_ns = later.values[0] - earlier.values[0]
        if step_ns < 0 or (strictly and step_ns == 0):
            problem = f"expected a time {'after' if strictly else 'not before'} the one above it"
            raise InputError(f"{problem}, found a step of {step_ns} ns", path=path, line=later.line, field="time")
