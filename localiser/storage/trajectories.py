"""Trajectories: CSV in our frame, and TUM (`t x y z qx qy qz qw`) in the ROS frame, for other programs."""

from __future__ import annotations

import math
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from localiser import geometry
from localiser.documents import read_text, shown
from localiser.errors import InputError
from localiser.geometry import Array, Trajectory
from localiser.storage.files import write_text
from localiser.storage.tables import MAX_TABLE_BYTES, Column, integer, number, plain, read_table

POSE_COLUMNS = (Column("t_ns", integer), Column("x", number), Column("z", number), Column("heading", number))

_NS = 1_000_000_000
_TUM_FIELDS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")


def load_poses(path: Path) -> Trajectory:
    """Return the trajectory in a CSV table `t_ns,x,z,heading`, at least one row. Raises InputError."""
    table = read_table(path, POSE_COLUMNS, rows_at_least=1)
    table.require_time_order(strictly=True)
    return Trajectory(table.integers("t_ns"), table.numbers("x", "z", "heading"))


def save_poses(trajectory: Trajectory, path: Path) -> None:
    """Write a CSV table `t_ns,x,z,heading`. Raises OutputError."""
    rows = zip(trajectory.t_ns, trajectory.poses, strict=True)
    lines = (f"{t_ns},{x:.9f},{z:.9f},{heading:.9f}\n" for t_ns, (x, z, heading) in rows)
    write_text(path, "t_ns,x,z,heading\n" + "".join(lines))


# -- TUM --------------------------------------------------------------------------------------------------------------


def save_tum(trajectory: Trajectory, path: Path) -> None:
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


def nanoseconds(text: str) -> int:
    """Return decimal seconds as integer nanoseconds, rounded to the nearest. Raises ValueError."""
    try:
        value = Decimal(plain(text))
    except (InvalidOperation, ValueError):
        raise ValueError("a time in seconds") from None
    if not value.is_finite() or value.adjusted() > 9:
        raise ValueError("a time in seconds below 1e10")
    return round(value * _NS)


def load_tum(path: Path) -> Trajectory:
    """Return the poses in our frame of a TUM file of any program; the floor part of each pose.

    Lines that start with # are comments. Raises InputError with file, line and field.
    """
    times: list[int] = []
    rows: list[list[float]] = []
    for line, content in enumerate(read_text(path, MAX_TABLE_BYTES).split("\n"), start=1):
        cells = content.split()
        if not cells or cells[0].startswith("#"):
            continue
        if len(cells) != len(_TUM_FIELDS):
            wanted = f"{len(_TUM_FIELDS)} numbers ({' '.join(_TUM_FIELDS)})"
            raise InputError(f"expected {wanted}, found {len(cells)}", path=path, line=line)
        for field, cell in zip(_TUM_FIELDS, cells, strict=True):
            try:
                if field == "t":
                    times.append(_time_after(cell, times))
                    rows.append([])
                else:
                    rows[-1].append(number(cell))
            except ValueError as error:
                problem = f"expected {error}, found {shown(cell)}"
                raise InputError(problem, path=path, line=line, field=field) from None
        _check_quaternion(path, line, rows[-1][3:])
    if not rows:
        raise InputError("expected at least one pose, found none", path=path)
    x, y, _, qx, qy, qz, qw = np.array(rows).T
    yaw = np.arctan2(2 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
    return Trajectory(np.array(times, dtype=np.int64), geometry.pose_from_ros(np.column_stack([x, y, yaw])))


def _time_after(cell: str, times: list[int]) -> int:
    t_ns = nanoseconds(cell)
    if times and t_ns <= times[-1]:
        raise ValueError(f"a time after {seconds(times[-1])}")
    return t_ns


def _check_quaternion(path: Path, line: int, quaternion: list[float]) -> None:
    length = math.hypot(*quaternion)
    if abs(length - 1) > 0.01:
        raise InputError(
            f"expected a quaternion of length 1, found length {length:.4g}", path=path, line=line, field="qx qy qz qw"
        )
