"""The UTIAS multi-robot data set: real robots that see 15 cylinders, each with a barcode, by bearing and range.

Leung, Halpern, Barfoot, Liu, "The UTIAS multi-robot cooperative localization and mapping dataset", IJRR 30(8), 2011.
A log is one robot of a data set, `FOLDER:1`. Only bearings are used; barcodes say which landmark was seen, which the
filter does not look at. What is no landmark, another robot or a barcode that was misread, stays in as clutter.

After `register`, `open_log` reads such logs. As a program this is `localiser` with that format:

python benchmarks/mrclam.py replay ../shared/data/mrclam:1 --start truth --seed 0
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
from coarse_bearings import coarse_bearings
from numpy.typing import NDArray

from localiser import geometry
from localiser.documents import plain_name
from localiser.edges import BearingSensor, Edges, complete
from localiser.errors import InputError
from localiser.filter import Sighting
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.mapping import BUILDERS
from localiser.storage import FORMATS
from localiser.storage.edge_tables import MOST_EDGES
from localiser.storage.log import Log, ReadOptions
from localiser.storage.tables import Column, integer, number, read_columns
from localiser.storage.trajectories import nanoseconds

ODOMETRY_QUALITY = {
    "motion.alpha1": 0.01,
    "motion.alpha2": 0.01,
    "motion.alpha3": 0.003,
    "motion.alpha4": 0.001,
    "motion.bias.distance_sigma": 0.1,
    "motion.bias.turn_sigma": 0.1,
    "motion.bias.veer_sigma_deg_per_m": 3.0,
    "motion.bias.delay_sigma_s": 0.2,
}
"""Velocities are as commanded, not as driven: off by a constant tenth, late by tenths of a second, and off by some
degrees and 2 cm every 2 s."""

_TIME = Column("time", nanoseconds)


class MrclamReader:
    """Reads one robot of a data set."""

    format, looks_like, options = "mrclam", "FOLDER:N of the UTIAS data set", ()

    def recognises(self, path: Path) -> bool:
        """Whether `path` is FOLDER:N with the files of robot N, or a folder with those of any robot."""
        folder, robot = _split(path)
        return (folder / f"Robot{robot or 1}_Odometry.dat").exists()

    def read(self, path: Path, options: ReadOptions) -> Log:
        """Return the log of one robot. Raises InputError."""
        folder, robot = _split(path)
        if robot is None:
            raise InputError(f"expected a robot's number, as in {path}:1, found none", path=path)
        if not folder.is_dir():
            raise InputError("no such folder", path=folder)
        odometry = _odometry(folder / f"Robot{robot}_Odometry.dat")
        truth = _groundtruth(folder / f"Robot{robot}_Groundtruth.dat")
        landmark_map = _landmarks(folder / "Landmark_Groundtruth.dat")
        sightings = _sightings(folder, robot, landmark_map, options.sensor)
        # Without truth a frame cannot be judged, without odometry not be located.
        frames = [frame for frame in sightings if odometry.covers(frame.t_ns) and truth.covers(frame.t_ns)]
        if not frames:
            problem = "expected measurements while there is odometry and truth, found none"
            raise InputError(problem, path=folder / f"Robot{robot}_Measurement.dat")
        name = f"{plain_name(folder.resolve().name)}-robot{robot}"
        return Log(
            name=name,
            path=folder,
            camera=options.sensor.camera(name),
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
    table = read_columns(path, (_TIME, Column("forward velocity", number), Column("angular velocity", number)))
    table.require_time_order("time", strictly=False)
    # Of several commands at one time only the last is ever driven.
    t_ns = table.integers("time")
    driven = np.append(np.diff(t_ns) > 0, True)
    return integrated(t_ns[driven], *table.numbers("forward velocity", "angular velocity")[driven].T)


def _groundtruth(path: Path) -> Trajectory:
    table = read_columns(path, (_TIME, *(Column(name, number) for name in ("x", "y", "orientation"))))
    table.require_time_order("time", strictly=True)
    return Trajectory(table.integers("time"), geometry.pose_from_ros(table.numbers("x", "y", "orientation")))


def _landmarks(path: Path) -> LandmarkMap:
    """Return the map, in the order of the file; ids are the numbers of the subjects."""
    measured = (Column(name, number) for name in ("x", "y", "x std-dev", "y std-dev"))
    table = read_columns(path, (Column("subject", integer), *measured))
    ids = tuple(table.columns["subject"])
    counts = Counter(ids)
    for row, subject in enumerate(ids):
        if counts[subject] > 1:
            raise table.error(row, "subject", f"landmark {subject} given twice")
    points = table.numbers("x", "y") * [1.0, -1.0]
    landmark_map = LandmarkMap.from_points(points, name=plain_name(path.parent.name), ids=ids, source="motion capture")
    return replace(landmark_map, cov=table.numbers("x std-dev", "y std-dev")[..., None] ** 2 * np.eye(2))


def _sightings(folder: Path, robot: int, landmark_map: LandmarkMap, sensor: BearingSensor) -> Iterator[Sighting]:
    """Yield the bearings of each time as one frame; other robots and unknown barcodes have the landmark id -1."""
    path = folder / f"Robot{robot}_Measurement.dat"
    table = read_columns(path, (_TIME, Column("barcode", integer), Column("range", number), Column("bearing", number)))
    table.require_time_order("time", strictly=False)
    for row, bearing in enumerate(table.columns["bearing"]):
        if abs(bearing) >= np.pi / 2:
            raise table.error(row, "bearing", f"expected a bearing within ±π/2, found {bearing}")
    codes = read_columns(folder / "Barcodes.dat", (Column("subject", integer), Column("barcode", integer)))
    subjects = dict(zip(codes.columns["barcode"], codes.columns["subject"], strict=True))
    index = {subject: place for place, subject in enumerate(landmark_map.ids)}
    sigma, tilt = math.radians(sensor.bearing_sigma_deg), math.radians(sensor.tilt_deg)
    rows = zip(*(table.columns[name] for name in ("time", "barcode", "bearing")), strict=True)
    row = 0
    for t_ns, frame in groupby(rows, key=lambda row: row[0]):
        _, barcodes, bearings = zip(*frame, strict=True)
        if len(bearings) > MOST_EDGES:
            problem = f"expected at most {MOST_EDGES} measurements at one time, found {len(bearings)}"
            raise table.error(row + MOST_EDGES, "time", problem)
        row += len(bearings)
        bearing = -np.array(bearings)  # positive to the left in the file
        unknown = np.full(len(bearing), np.nan)
        landmark = [index.get(subjects.get(barcode, 0), -1) for barcode in barcodes]
        measured = complete(bearing, np.full(len(bearing), sigma), unknown, unknown, tilt)
        yield Sighting(t_ns, Edges.from_columns(*measured, landmark_id=np.array(landmark, dtype=np.int64)))


def register() -> None:
    """Let `open_log` read such logs, and `build_map` build maps of coarse bearings."""
    if not any(isinstance(reader, MrclamReader) for reader in FORMATS):
        FORMATS.append(MrclamReader())
        BUILDERS.insert(0, coarse_bearings)


if __name__ == "__main__":
    from localiser.__main__ import main

    register()
    main()
