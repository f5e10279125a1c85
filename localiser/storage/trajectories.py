"""Read and write trajectories: CSV in our frame or the ROS frame; TUM and EuRoC as other programs have them."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np

from localiser import geometry
from localiser.documents import output_errors, read_text, shown, write_all, write_text
from localiser.errors import InputError, warn
from localiser.evaluate import Track, found_images
from localiser.filter import NOT_FOUND, LocatedFrame
from localiser.geometry import Array, Trajectory
from localiser.storage.tables import (
    MAX_TABLE_BYTES,
    Column,
    Table,
    integer,
    number,
    number_or_lost,
    number_or_unknown,
    plain,
    read_columns,
    read_table,
)

POSE_COLUMNS = (Column("t_ns", integer), Column("x", number), Column("z", number), Column("heading", number))

_NS = 1_000_000_000
_LEAST_DIGITS_OF_NS = 13  # seconds since 1970 have ten before the point
_MOST_LOST = 0.1  # of the poses
_UPRIGHT, _FLAT, _LEAST_PATH_M = 0.7, 0.2, 1.0  # cosine of an axis that points up; height of a path by its length


_FORMS = (
    "expected the header t_ns,x,z,heading (our frame), or t,x,y,yaw or t_ns,x,y,yaw (ROS: x forward, y left, yaw "
    "anticlockwise), or lines of TUM (t x y z qx qy qz qw) or EuRoC (t_ns,x,y,z,qw,qx,qy,qz)"
)
_FORMULA = "from axes as ROS has them, our x = x, z = -y, heading = yaw - π/2; metres, radians"


def read_poses(path: Path) -> Trajectory:
    """Return the poses in our frame of a file, at least one; its first lines say which form it has.

    CSV `t_ns,x,z,heading` in our frame; CSV `t,x,y,yaw` or `t_ns,x,y,yaw` in the ROS frame; TUM; EuRoC. Times are
    seconds, or whole nanoseconds from 10¹² on. Of poses with the same time the first is kept; poses that are nan or
    empty are left out, up to a tenth; a warning says so, and also where poses are in a camera's axes and are turned.
    Raises InputError.
    """
    lines = [line.strip() for line in read_text(path, MAX_TABLE_BYTES).splitlines() if line.strip()]
    row = next((line for line in lines if not line.startswith("#")), "")
    cells = row.replace(",", " ").split()
    names = {name.strip() for name in row.split(",")}
    if "," in row and cells and cells[0].replace(".", "", 1).isdigit():
        return _read_quaternions(path, _EUROC, ",")
    if "," not in row and (len(cells) == len(_TUM) or (lines and lines[0].startswith("#"))):
        return _read_quaternions(path, _TUM)
    time = "t" if "t" in names else "t_ns"
    if names == {time, "x", "y", "yaw"}:
        table = read_table(path, (Column(time, _time), *(Column(name, number_or_lost) for name in ("x", "y", "yaw"))))
        return _trajectory(table, geometry.pose_from_ros(table.numbers("x", "y", "yaw")), time)
    if row and len(names & {"t_ns", "z", "heading"}) < 2:
        raise InputError(f"{_FORMS}, found {shown(row)}. {_FORMULA}", path=path, line=1)
    ours = (POSE_COLUMNS[0], *(Column(column.name, number_or_lost) for column in POSE_COLUMNS[1:]))
    table = read_table(path, ours, rows_at_least=1)
    return _trajectory(table, table.numbers("x", "z", "heading"), "t_ns")


def _trajectory(table: Table, poses: Array, time: str) -> Trajectory:
    """Return the poses (R, 3) of rows, without lost and repeated ones, of which a warning tells."""
    table.require_time_order(time, strictly=False)
    known, count = np.isfinite(poses).all(axis=1), len(table)
    if (lost := count - int(known.sum())) > _MOST_LOST * count:
        problem = f"expected at most a tenth of the poses to be empty, null or nan, found {lost} of {count}"
        raise table.error(int(np.argmin(known)), list(table.columns)[-1], problem)
    rows = np.flatnonzero(known)
    again = np.diff(table.integers(time)[rows], prepend=np.iinfo(np.int64).min) == 0
    if lost:
        warn(f"left out {lost} of {count} poses that are empty, null or nan", path=table.path)
    if again.any():
        row = int(rows[again][0])
        repeated = f"left out {again.sum()} of {count} poses of a time that was there already, such as"
        warn(f"{repeated} {table.written(row, time)}", path=table.path, line=table.lines[row])
    return Trajectory(table.integers(time)[rows][~again], poses[rows][~again])


def _read_quaternions(path: Path, columns: tuple[Column, ...], separator: str | None = None) -> Trajectory:
    table = read_columns(path, columns, separator)
    q = table.numbers("qx", "qy", "qz", "qw")
    length = np.linalg.norm(q, axis=1)
    if (wrong := np.flatnonzero((np.abs(length - 1) > 0.01) & (length != 0))).size:
        row = int(wrong[0])
        raise table.error(row, "qx qy qz qw", f"expected a quaternion of length 1, found length {length[row]:.4g}")
    q[length == 0] = np.nan  # of a robot that was lost
    if np.nanmedian(_axes(q)[:, 2, 2]) < _UPRIGHT and np.nanmin(_axes(q[:, [1, 2, 3, 0]])[:, 2, 2]) > _UPRIGHT:
        problem = "expected a robot whose z axis points up, found one that lies down, and stands with qw put first"
        raise table.error(0, "qx qy qz qw", f"{problem}: is the order of columns qw qx qy qz? Put qw last")
    return _trajectory(table, _on_floor(path, table.numbers("x", "y", "z"), _axes(q)), "t")


def _axes(q: Array) -> Array:
    """Return rotation matrices (R, 3, 3) of quaternions (R, 4) of about unit length, w last."""
    x, y, z, w = q.T
    ahead = [w**2 + x**2 - y**2 - z**2, 2 * (w * z + x * y), 2 * (x * z - w * y)]
    left = [2 * (x * y - w * z), w**2 - x**2 + y**2 - z**2, 2 * (y * z + w * x)]
    up = [2 * (x * z + w * y), 2 * (y * z - w * x), w**2 - x**2 - y**2 + z**2]
    return np.moveaxis(np.array([ahead, left, up]), -1, 0).transpose(0, 2, 1)


def _on_floor(path: Path, places: Array, axes: Array) -> Array:
    """Return the poses (R, 3) in our frame of places (R, 3) and axes (R, 3, 3, columns) of a robot or of a camera.

    ROS has z up; a camera has x right, y down, z ahead. Which it is shows in what points up and where the path lies.
    """
    x, y, z = places.T
    wide, deep, high = (np.nanmax(part) - np.nanmin(part) if np.isfinite(part).any() else 0.0 for part in places.T)
    if high > max(_LEAST_PATH_M, wide / 2, deep / _FLAT) and np.nanmedian(axes[:, 1, 1]) > _UPRIGHT:
        warn("the path lies in x and z: taken as in a camera's axes (x right, y down, z ahead)", path=path)
        return np.column_stack([x, -z, np.arctan2(-axes[:, 0, 2], axes[:, 2, 2])])
    ahead = axes[:, :, 0]
    if np.nanmedian(axes[:, 2, 2]) < _UPRIGHT and np.nanmedian(axes[:, 2, 1]) < -_UPRIGHT:
        warn("the y axis of the poses points down: taken as those of a camera that looks along its z axis", path=path)
        ahead = axes[:, :, 2]
    elif np.nanmedian(axes[:, 2, 2]) < _UPRIGHT:
        warn("expected poses whose z axis points up, found others: their headings say nothing", path=path)
    return geometry.pose_from_ros(np.column_stack([x, y, np.arctan2(ahead[:, 1], ahead[:, 0])]))


def write_poses(trajectory: Trajectory, path: Path) -> None:
    """Write a CSV table `t_ns,x,z,heading`. Raises OutputError."""
    rows = zip(trajectory.t_ns, trajectory.poses, strict=True)
    lines = (f"{t_ns},{x:.9f},{z:.9f},{heading:.9f}\n" for t_ns, (x, z, heading) in rows)
    write_text(path, "t_ns,x,z,heading\n" + "".join(lines))


def write_tum(trajectory: Trajectory, path: Path) -> None:
    """Write a TUM file in the ROS frame. Raises OutputError."""
    rows = zip(trajectory.t_ns, trajectory.poses, strict=True)
    write_text(path, "".join(tum_line(int(t_ns), pose) for t_ns, pose in rows))


def tum_line(t_ns: int, pose: Array) -> str:
    """Return the line of one pose (3,) of our frame, in the ROS frame."""
    x, y, yaw = geometry.ros_from_pose(pose)
    values = (x, y, 0.0, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
    return " ".join([seconds(t_ns), *(f"{value:.9f}" for value in values)]) + "\n"


def seconds(t_ns: int) -> str:
    """Return a time as decimal seconds with all nine digits; a float would lose some of them."""
    whole, rest = divmod(abs(t_ns), _NS)
    return f"{'-' if t_ns < 0 else ''}{whole}.{rest:09d}"


def _time(text: str) -> int:
    """Return a time in seconds, or in whole nanoseconds where it is too large for seconds, as ns. Raises ValueError."""
    if text.strip().isdigit() and len(text.strip()) >= _LEAST_DIGITS_OF_NS:
        return integer(text)
    return nanoseconds(text)


def nanoseconds(text: str) -> int:
    """Return decimal seconds as integer nanoseconds, rounded to the nearest. Raises ValueError."""
    try:
        value = Decimal(plain(text))
    except (InvalidOperation, ValueError):
        raise ValueError("a time in seconds") from None
    if not value.is_finite() or value.adjusted() > 9:
        raise ValueError("a time in seconds below 1e10")
    return round(value * _NS)


_FLOATS = {name: Column(name, number_or_lost) for name in ("x", "y", "z", "qx", "qy", "qz", "qw")}
_TUM = (Column("t", _time), *_FLOATS.values())
_EUROC = (Column("t", _time), *(_FLOATS[name] for name in ("x", "y", "z", "qw", "qx", "qy", "qz")))


# -- what a run located, image by image; one that breaks off leaves what it did ---------------------------------------


TRAJECTORY_CSV = "trajectory.csv"
TRAJECTORY_TUM = "trajectory.tum"
GROUNDTRUTH_TUM = "groundtruth.tum"

_COV = ("cov_xx", "cov_xz", "cov_xh", "cov_zz", "cov_zh", "cov_hh")
_ODOMETRY = ("odometry_x", "odometry_z", "odometry_heading")
PLACE = 0.05  # of the weight that a place must have to be counted
_UPPER = np.triu_indices(3)
COLUMNS = (
    *POSE_COLUMNS,
    *(Column(name, number) for name in (*_COV, "ess")),
    *(Column(name, number_or_unknown, required=False) for name in ("edges", *_ODOMETRY, "p_correct")),
    Column("reason", str, required=False),
    Column("places", number_or_unknown, required=False),
)


class TrackWriter:
    """Writes `trajectory.csv`, `trajectory.tum` and, where the truth is known, `groundtruth.tum`, a line an image.

    The CSV holds our frame, the TUM files the ROS frame. p_correct: probability of being within 0.5 m and 10°; reason:
    why it is low; places: where the robot may be. Columns of constant errors follow the listed ones, each with its
    sigma; of several maps the name of the one that a pose is on is last. Raises OutputError.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, FileIO] = {}
        self._write(TRAJECTORY_TUM, "")

    def frame(self, frame: LocatedFrame) -> None:
        """Write what the filter knows after one image."""
        located, estimate = frame.located, frame.located.estimate
        constants = estimate.names[3:]
        self._begin_csv(constants, with_map=bool(frame.map_name))
        cells = [str(located.t_ns)]
        cells += [f"{value:.9f}" for value in estimate.pose]
        cells += [f"{value:.9e}" for value in frame.pose_cov[_UPPER]]
        cells += [f"{located.ess:.3f}", str(len(located.edges))]
        cells += ["" if np.isnan(value) else f"{value:.9f}" for value in located.odometry]
        places = 1 if located.clusters is None else int((located.clusters.weight >= PLACE).sum())
        cells += [f"{located.p_correct:.4f}", located.reason, str(places)]
        for column in range(3, 3 + len(constants)):
            cells += [f"{estimate.mean[column]:.9e}", f"{np.sqrt(estimate.cov[column, column]):.9e}"]
        cells += [frame.map_name.replace(",", "_")] if frame.map_name else []
        self._write(TRAJECTORY_CSV, ",".join(cells) + "\n")
        if frame.is_found:
            self._write(TRAJECTORY_TUM, tum_line(located.t_ns, estimate.pose))
        if frame.truth is not None:
            self._write(GROUNDTRUTH_TUM, tum_line(located.t_ns, frame.truth))

    def close(self, complete: bool) -> None:
        """End the files; they hold every image so far whether the run is complete or not."""
        self._begin_csv(())
        for name, file in self._files.items():
            with output_errors(self._folder / name):
                file.close()

    def _begin_csv(self, constants: tuple[str, ...], *, with_map: bool = False) -> None:
        if TRAJECTORY_CSV not in self._files:
            names = [column.name for column in COLUMNS] + [
                f"{name}{end}" for name in constants for end in ("", "_sigma")
            ]
            self._write(TRAJECTORY_CSV, ",".join(names + ["map"] * with_map) + "\n")

    def _write(self, name: str, text: str) -> None:
        """Append to a file, made when it is first written; all of the text is handed to the system, or none."""
        with output_errors(self._folder / name):
            if name not in self._files:
                self._files[name] = (self._folder / name).open("wb", buffering=0)
            file = self._files[name]
            whole = file.tell()
            try:
                write_all(file.write, text.encode())
            except OSError:
                file.seek(whole)
                file.truncate()
                raise


def read_track(path: Path) -> Track:
    """Return what a `trajectory.csv` says; columns of a newer version are passed over.

    Raises InputError, also for poses on several maps: they have no frame in common.
    """
    table = read_table(path, COLUMNS, rows_at_least=1, more_columns=True)
    table.require_time_order(strictly=True)
    for row, name in enumerate(maps := table.columns.get("map", [])):
        if name != maps[0]:
            expected = f"expected poses on one map to compare with a truth, such as {shown(maps[0])}"
            raise table.error(row, "map", f"{expected}, found {shown(name)}")
    covs = np.empty((len(table), 3, 3))
    covs[:, _UPPER[0], _UPPER[1]] = covs[:, _UPPER[1], _UPPER[0]] = table.numbers(*_COV)
    known: dict[str, Any] = {name: table.numbers(name) for name in ("edges", "p_correct") if name in table.columns}
    if all(name in table.columns for name in _ODOMETRY):
        known["odometry"] = table.numbers(*_ODOMETRY)
    if "p_correct" in known:
        looked_for = table.columns.get("reason", ("",))[0] == NOT_FOUND
        known["found"] = found_images(known["p_correct"], is_found=not looked_for)
    return Track.from_poses(table.integers("t_ns"), table.numbers("x", "z", "heading"), covs=covs, **known)
