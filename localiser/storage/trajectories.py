"""Read and write trajectories: CSV in our frame, TUM (`t x y z qx qy qz qw`) in the ROS frame."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from localiser import geometry
from localiser.geometry import Array, Trajectory
from localiser.storage.files import write_text
from localiser.storage.tables import Column, integer, number, plain, read_columns, read_table

POSE_COLUMNS = (Column("t_ns", integer), Column("x", number), Column("z", number), Column("heading", number))

_NS = 1_000_000_000


def read_poses(path: Path) -> Trajectory:
    """Return the trajectory in a CSV table `t_ns,x,z,heading`, at least one row. Raises InputError."""
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
