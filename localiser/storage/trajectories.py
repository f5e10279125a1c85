"""Read and write trajectories: CSV in our frame or the ROS frame, TUM (`t x y z qx qy qz qw`) in the ROS frame."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from localiser import geometry
from localiser.documents import read_text, shown, write_text
from localiser.errors import InputError
from localiser.geometry import Array, Trajectory
from localiser.storage.tables import MAX_TABLE_BYTES, Column, integer, number, plain, read_columns, read_table

POSE_COLUMNS = (Column("t_ns", integer), Column("x", number), Column("z", number), Column("heading", number))

_ROS = (Column("x", number), Column("y", number), Column("yaw", number))

_NS = 1_000_000_000
_LEAST_DIGITS_OF_NS = 13  # seconds since 1970 have ten before the point


_FORMS = (
    "expected the header t_ns,x,z,heading (our frame), or t,x,y,yaw or t_ns,x,y,yaw (ROS: x forward, y left, yaw "
    "anticlockwise), or lines of TUM (t x y z qx qy qz qw)"
)
_FORMULA = "from axes as ROS has them, our x = x, z = -y, heading = yaw - π/2; metres, radians"


def read_poses(path: Path) -> Trajectory:
    """Return the poses in our frame of a file, at least one; its header says which of three forms it has.

    CSV `t_ns,x,z,heading` in our frame; CSV `t,x,y,yaw` in the ROS frame, with seconds, or `t_ns,x,y,yaw`; TUM, which
    has no header. Whole numbers of at least 10¹² in the column `t` are nanoseconds. Raises InputError.
    """
    header = next((line.strip() for line in read_text(path, MAX_TABLE_BYTES).splitlines() if line.strip()), "")
    names = {name.strip() for name in header.split(",")}
    if header and (header.startswith("#") or ("," not in header and len(header.split()) == len(_TUM_COLUMNS))):
        return read_tum(path)
    if len(names) == len(_ROS) + 1 and names.issuperset(column.name for column in _ROS) and names & {"t", "t_ns"}:
        return _read_ros(path, "t" if "t" in names else "t_ns")
    if header and len(names & {"t_ns", "z", "heading"}) < 2:
        raise InputError(f"{_FORMS}, found {shown(header)}. {_FORMULA}", path=path, line=1)
    return _read_ours(path)


def _read_ros(path: Path, time: str) -> Trajectory:
    table = read_table(path, (Column(time, integer if time == "t_ns" else _seconds_or_ns), *_ROS), rows_at_least=1)
    table.require_time_order(time, strictly=True)
    return Trajectory(table.integers(time), geometry.pose_from_ros(table.numbers("x", "y", "yaw")))


def _read_ours(path: Path) -> Trajectory:
    table = read_table(path, POSE_COLUMNS, rows_at_least=1)
    table.require_time_order(strictly=True)
    return Trajectory(table.integers("t_ns"), table.numbers("x", "z", "heading"))


def write_poses(trajectory: Trajectory, path: Path) -> None:
    """Write a CSV table `t_ns,x,z,heading`. Raises OutputError."""
    rows = zip(trajectory.t_ns, trajectory.poses, strict=True)
    lines = (f"{t_ns},{x:.9f},{z:.9f},{heading:.9f}\n" for t_ns, (x, z, heading) in rows)
    write_text(path, "t_ns,x,z,heading\n" + "".join(lines))


# -- TUM --------------------------------------------------------------------------------------------------------------


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


def _seconds_or_ns(text: str) -> int:
    """Return a time in seconds, or in whole nanoseconds where it is too large for seconds, as ns. Raises ValueError."""
    if text.strip().isdigit() and len(text.strip()) >= _LEAST_DIGITS_OF_NS:
        return integer(text)
    try:
        return nanoseconds(text)
    except ValueError:
        raise ValueError("a time in seconds, or in whole nanoseconds from 10¹² on") from None


def nanoseconds(text: str) -> int:
    """Return decimal seconds as integer nanoseconds, rounded to the nearest. Raises ValueError."""
    try:
        value = Decimal(plain(text))
    except (InvalidOperation, ValueError):
        raise ValueError("a time in seconds") from None
    if not value.is_finite() or value.adjusted() > 9:
        raise ValueError("a time in seconds below 1e10")
    return round(value * _NS)


_TUM_COLUMNS = (Column("t", nanoseconds), *(Column(name, number) for name in ("x", "y", "z", "qx", "qy", "qz", "qw")))


def read_tum(path: Path) -> Trajectory:
    """Return the poses in our frame of a TUM file of any program; the floor part of each pose.

    Lines that start with # are comments. Raises InputError with file, line and field.
    """
    table = read_columns(path, _TUM_COLUMNS)
    table.require_time_order("t", strictly=True)
    x, y, qx, qy, qz, qw = table.numbers("x", "y", "qx", "qy", "qz", "qw").T
    length = np.sqrt(qx**2 + qy**2 + qz**2 + qw**2)
    if (wrong := np.flatnonzero(np.abs(length - 1) > 0.01)).size:
        row = int(wrong[0])
        raise table.error(row, "qx qy qz qw", f"expected a quaternion of length 1, found length {length[row]:.4g}")
    yaw = np.arctan2(2 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
    return Trajectory(table.integers("t"), geometry.pose_from_ros(np.column_stack([x, y, yaw])))
