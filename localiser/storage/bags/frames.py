"""Convert between frames of ROS and ours: the camera's mount in a tree of transforms, floor poses.

ROS (REP-103): a robot's frame has x forward, y left, z up; a camera's optical frame x right, y down, z forward.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from localiser.camera import Mount
from localiser.geometry import Array, pose_from_ros, ros_cov_from_cov, wrap_angle

FLOOR_FRAME = "base_footprint"  # REP-120: the robot's frame, let down to the floor

_ROBOT_FROM_BASE = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
_OPTICAL_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])
_LARGEST_M = 100.0
LEAST_HEIGHT_M = 1e-3  # of a camera above the floor
_LARGEST_POSITION_M = 1e9
_LARGEST_START_M = 1e6  # from the map's origin, as in a log's start
_LARGEST_SIGMA_M, _LARGEST_SIGMA_RAD = 1000.0, 2 * math.pi
FLOOR_ROWS = np.ix_((0, 1, 5), (0, 1, 5))  # x, y, yaw among x, y, z and the turns about them


class FrameTree:
    """Transforms between named frames at one time. A transform is (4, 4) and takes points of a child to its parent."""

    def __init__(self) -> None:
        """Start with no frame."""
        self._neighbours: dict[str, dict[str, Array]] = {}

    def add_all(self, transforms: Iterable[Any]) -> None:
        """Add the transforms of a tf2_msgs/TFMessage, all or none. Raises ValueError when one is no rigid motion."""
        found = []
        for stamped in transforms:
            parent, child = plain_frame(stamped.header.frame_id), plain_frame(stamped.child_frame_id)
            moved, turned = stamped.transform.translation, stamped.transform.rotation
            transform: Array = np.eye(4)
            transform[:3, :3] = rotation_from_quaternion(turned.x, turned.y, turned.z, turned.w)
            transform[:3, 3] = moved.x, moved.y, moved.z
            _require_near(parent, child, transform)
            found.append((parent, child, transform))
        for parent, child, transform in found:
            self.add(parent, child, transform)

    def add(self, parent: str, child: str, transform: Array) -> None:
        """Add a transform (4, 4). Raises ValueError when the child is too far away."""
        _require_near(parent, child, transform)
        self._neighbours.setdefault(parent, {})[child] = transform
        self._neighbours.setdefault(child, {})[parent] = np.asarray(np.linalg.inv(transform))

    def link(self, parent: str, child: str) -> None:
        """Add that a transform joins two frames, unless one is there."""
        for one, other in ((parent, child), (child, parent)):
            self._neighbours.setdefault(one, {}).setdefault(other, np.eye(4))

    def copy(self) -> FrameTree:
        """Return a tree with the same transforms."""
        other = FrameTree()
        other._neighbours = {frame: dict(beside) for frame, beside in self._neighbours.items()}
        return other

    def chain(self, target: str, source: str) -> list[tuple[str, str]] | None:
        """Return the pairs of neighbours from one frame to another, by the fewest transforms; None where none lead."""
        steps: dict[str, list[tuple[str, str]]] = {target: []}
        waiting = [target]
        while waiting and source not in steps:
            frame = waiting.pop(0)
            for neighbour in self._neighbours.get(frame, {}):
                if neighbour not in steps:
                    steps[neighbour] = [*steps[frame], (frame, neighbour)]
                    waiting.append(neighbour)
        return steps.get(source)

    def __contains__(self, frame: str) -> bool:
        return frame in self._neighbours

    def between(self, target: str, source: str) -> Array:
        """Return the transform (4, 4) from `source` to `target` along any chain of frames. Raises ValueError."""
        steps = self.chain(target, source)
        if steps is None:
            known = ", ".join(sorted(self._neighbours)) or "no frame at all"
            raise ValueError(f"expected transforms from {target!r} to {source!r}, found {known}")
        transform: Array = np.eye(4)
        for frame, neighbour in steps:
            transform = transform @ self._neighbours[frame][neighbour]
        return transform


def _require_near(parent: str, child: str, transform: Array) -> None:
    if not (np.abs(transform[:3, 3]) <= _LARGEST_M).all():
        raise ValueError(f"expected {child!r} within {_LARGEST_M:g} m of {parent!r}")


def plain_frame(name: str) -> str:
    """Return the name of a frame without the slash that old ROS 1 drivers put before it."""
    return str(name).lstrip("/")


def rotation_from_quaternion(x: float, y: float, z: float, w: float) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion. Raises ValueError unless its length is 1."""
    length = math.hypot(x, y, z, w)
    if not abs(length - 1) <= 0.01:
        raise ValueError(f"expected a quaternion of length 1, found length {length:.4g}")
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / length
    return np.asarray(np.eye(3) + 2 * w / length * cross + 2 * cross @ cross)


def quaternion_from_rotation(rotation: Array) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w), w ≥ 0, of a rotation matrix (3, 3).

    The eigenvector of the largest eigenvalue of Bar-Itzhack's matrix, which has no special cases.
    """
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = rotation
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = rotation + rotation.T - np.trace(rotation) * np.eye(3)
    matrix[3] = matrix[:, 3] = zy - yz, xz - zx, yx - xy, np.trace(rotation)
    x, y, z, w = np.linalg.eigh(matrix)[1][:, -1].tolist()
    return (x, y, z, w) if w >= 0 else (-x, -y, -z, -w)


# -- mount ------------------------------------------------------------------------------------------------------------


def mount_of(tree: FrameTree, base: str, optical: str) -> Mount:
    """Return the mount of the camera with the frame `optical` on the robot with the frame `base`.

    Heights are above the floor: above FLOOR_FRAME where the tree has it, else above `base`. Angles are rounded to
    1e-10 degrees and lengths to 1e-10 m, far below what can be known, so that writing and reading again changes
    nothing. Raises ValueError when no chain of frames joins the two, or the camera is not above the floor.
    """
    base_from_optical = tree.between(base, optical)
    axes = _ROBOT_FROM_BASE @ base_from_optical[:3, :3] @ _OPTICAL_FROM_CAMERA
    place = _ROBOT_FROM_BASE @ base_from_optical[:3, 3]
    height_m = tree.between(FLOOR_FRAME, optical)[2, 3] if FLOOR_FRAME in tree else place[1]
    if not height_m >= LEAST_HEIGHT_M:
        raise ValueError(f"expected the camera {optical!r} above the floor, found it {height_m:.3f} m high")
    # axes = turn(yaw) @ tilt @ roll of `Camera`; its last column is where the camera's back points.
    tilt = math.atan2(axes[1, 2], math.hypot(axes[0, 2], axes[2, 2]))
    if not abs(math.degrees(tilt)) < 89.9:
        raise ValueError("expected a camera that does not look straight up or down")
    return Mount(
        tilt_rad=rounded_angle(tilt),
        roll_rad=rounded_angle(math.atan2(-axes[1, 0], axes[1, 1])),
        yaw_rad=rounded_angle(math.atan2(axes[0, 2], axes[2, 2])),
        height_m=round(float(height_m), 10),
        right_m=round(float(place[0]), 10) + 0.0,
        back_m=round(float(place[2]), 10) + 0.0,
    )


def rounded_angle(angle_rad: float) -> float:
    """Return an angle, rounded to ten digits of a degree: one that was stated in degrees comes back as it was."""
    return math.radians(round(math.degrees(angle_rad), 10) + 0.0)  # + 0.0: no -0.0


def base_from_optical(mount: Mount, level_from_camera: Array) -> Array:
    """Return the transform (4, 4) from the optical frame to the robot's ROS frame; inverse of `mount_of`.

    level_from_camera: (3, 3) tilt and roll, of `Camera`.
    """
    cos, sin = math.cos(mount.yaw_rad), math.sin(mount.yaw_rad)
    turn = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    transform = np.eye(4)
    transform[:3, :3] = _ROBOT_FROM_BASE.T @ turn @ level_from_camera @ _OPTICAL_FROM_CAMERA
    transform[:3, 3] = _ROBOT_FROM_BASE.T @ np.array([mount.right_m, mount.height_m, mount.back_m])
    return transform


# -- floor poses ------------------------------------------------------------------------------------------------------


def floor_pose(message: Any) -> tuple[float, float, float]:
    """Return x, z, heading of a nav_msgs/Odometry or a PoseWithCovarianceStamped. Raises ValueError.

    Rounded to 1e-9, as log folders have them, so that converting a log and back changes nothing; wrapped after rounding
    and rounded again: -3.141592654 is less than -π.
    """
    pose = message.pose.pose
    at, turned = pose.position, pose.orientation
    if not (math.hypot(at.x, at.y) <= _LARGEST_POSITION_M):
        raise ValueError(f"expected a position within {_LARGEST_POSITION_M:.0e} m, found x = {at.x}, y = {at.y}")
    rotation = rotation_from_quaternion(turned.x, turned.y, turned.z, turned.w)
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    x, z, heading = np.round(pose_from_ros([at.x, at.y, yaw]), 9)
    return float(x), float(z), float(np.round(wrap_angle(heading), 9))


def floor_cov(message: Any) -> Array:
    """Return the covariance (3, 3) of x, z, heading of such a message. Raises ValueError unless it can be one."""
    cov = ros_cov_from_cov(np.asarray(message.pose.covariance, dtype=np.float64).reshape(6, 6)[FLOOR_ROWS])
    if not np.isfinite(cov).all() or not np.allclose(cov, cov.T) or not (np.linalg.eigvalsh(cov) > 0).all():
        raise ValueError("expected a covariance of x, y and yaw that is positive definite")
    return (cov + cov.T) / 2


def start_of_message(message: Any) -> tuple[Array, Array]:
    """Return the pose (3,) and its covariance (3, 3) where a robot is said to start. Raises ValueError.

    The position is within 1000 km, sigmas are at most 1000 m and a whole turn.
    """
    mean, cov = np.array(floor_pose(message)), floor_cov(message)
    check_start(mean, cov)
    return mean, cov


def check_start(mean: Array, cov: Array) -> None:
    """Raise ValueError unless a robot can start at a pose (3,) with a covariance (3, 3)."""
    if not (np.abs(mean[:2]) <= _LARGEST_START_M).all():
        raise ValueError(f"expected a start within {_LARGEST_START_M:.0e} m, found x = {mean[0]}, z = {mean[1]}")
    sigma, most = np.sqrt(np.diag(cov)), (_LARGEST_SIGMA_M, _LARGEST_SIGMA_M, _LARGEST_SIGMA_RAD)
    if not (sigma <= most).all():
        raise ValueError(f"expected sigmas of at most {most[0]:g} m and 2π rad, found {', '.join(map(str, sigma))}")
