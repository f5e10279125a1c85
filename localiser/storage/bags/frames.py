"""Convert between frames of ROS and ours: the camera's mount in a tree of transforms, floor poses.

ROS (REP-103): a robot's frame has x forward, y left, z up; a camera's optical frame x right, y down, z forward.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from heapq import nsmallest
from typing import Any

import numpy as np

from localiser.camera import Mount
from localiser.geometry import Array, pose_from_ros, ros_cov_from_cov, wrap_angle

FLOOR_FRAME = "base_footprint"  # REP-120: the robot's frame, let down to the floor
MOST_FRAMES, MOST_FRAMES_LIVE = 10_000, 1000  # a bag may hold those of many robots
MOST_STEPS = 100  # from the robot to its camera
_LONGEST_NAME, _MOST_LISTED = 256, 12

_ROBOT_FROM_BASE = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
_OPTICAL_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])
_LARGEST_M = 100.0
LEAST_HEIGHT_M = 1e-3  # of a camera above the floor
_LARGEST_POSITION_M = 1e9
_LARGEST_START_M = 1e6  # from the map's origin, as in a log's start
_LARGEST_SIGMA_M, _LARGEST_SIGMA_RAD = 1000.0, 2 * math.pi
FLOOR_ROWS = np.ix_((0, 1, 5), (0, 1, 5))  # x, y, yaw among x, y, z and the turns about them


Link = tuple[str, str]


class FrameTree:
    """Transforms between named frames at one time. A transform is (4, 4) and takes points of a child to its parent.

    neighbours: the frames beside each frame, with the transforms from them.
    """

    def __init__(self, most: int = MOST_FRAMES) -> None:
        """Start with no frame. most: how many there may be."""
        self.neighbours: dict[str, dict[str, Array]] = {}
        self._most = most
        self._chains: dict[Link, list[Link] | None] = {}

    def add_all(self, transforms: Sequence[Any]) -> None:
        """Add the transforms of a tf2_msgs/TFMessage, all or none.

        Raises ValueError when one is no rigid motion, or there are too many frames.
        """
        links = links_of(transforms)
        new = {frame for link in links for frame in link if frame not in self.neighbours}
        if len(self.neighbours) + len(new) > self._most:
            raise ValueError(f"expected at most {self._most} frames, found more")
        found = []
        for (parent, child), stamped in zip(links, transforms, strict=True):
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
        if child not in self.neighbours.get(parent, ()):
            self._chains.clear()
        self.neighbours.setdefault(parent, {})[child] = transform
        self.neighbours.setdefault(child, {})[parent] = np.asarray(np.linalg.inv(transform))

    def part(self, steps: Iterable[Link]) -> FrameTree:
        """Return a tree of the transforms between these neighbours alone, where there are any, and of FLOOR_FRAME."""
        other = FrameTree()
        if FLOOR_FRAME in self:
            other.neighbours[FLOOR_FRAME] = {}
        for step in steps:
            for frame, neighbour in (step, step[::-1]):
                if neighbour in self.neighbours.get(frame, ()):
                    other.neighbours.setdefault(frame, {})[neighbour] = self.neighbours[frame][neighbour]
        return other

    def copy(self) -> FrameTree:
        """Return a tree with the same transforms."""
        other = FrameTree()
        other.neighbours = {frame: dict(beside) for frame, beside in self.neighbours.items()}
        return other

    def chain(self, target: str, source: str) -> list[Link] | None:
        """Return the pairs of neighbours from one frame to another, as the function `chain`; they are remembered."""
        if (target, source) not in self._chains:
            self._chains[target, source] = chain([self.neighbours], target, source)
        return self._chains[target, source]

    def __contains__(self, frame: str) -> bool:
        return frame in self.neighbours

    def between(self, target: str, source: str) -> Array:
        """Return the transform (4, 4) from `source` to `target` along any chain of frames. Raises ValueError."""
        steps = self.chain(target, source)
        if steps is None:
            known = ", ".join(nsmallest(_MOST_LISTED, self.neighbours)) or "no frame at all"
            more = f" and {len(self.neighbours) - _MOST_LISTED} more" if len(self.neighbours) > _MOST_LISTED else ""
            raise ValueError(f"expected transforms from {target!r} to {source!r}, found {known}{more}")
        transform: Array = np.eye(4)
        for frame, neighbour in steps:
            transform = transform @ self.neighbours[frame][neighbour]
        return transform


def chain(neighbours: Sequence[Mapping[str, Iterable[str]]], target: str, source: str) -> list[Link] | None:
    """Return the pairs of neighbours from one frame to another, by the fewest transforms; None where none lead.

    neighbours: the frames beside each frame, in several mappings. A chain of more than `MOST_STEPS` is none.
    """
    came_from, waiting = {target: target}, deque([target])
    while waiting and source not in came_from:
        frame = waiting.popleft()
        for neighbour in (each for beside in neighbours for each in beside.get(frame, ())):
            if neighbour not in came_from:
                came_from[neighbour] = frame
                waiting.append(neighbour)
    steps: list[Link] = []
    frame = source if source in came_from else target
    while frame != target and len(steps) <= MOST_STEPS:
        steps.append((came_from[frame], frame))
        frame = came_from[frame]
    return steps[::-1] if source in came_from and len(steps) <= MOST_STEPS else None


def links_of(transforms: Iterable[Any]) -> list[Link]:
    """Return parent and child of each transform of a tf2_msgs/TFMessage. Raises ValueError for endless names."""
    links = [(plain_frame(each.header.frame_id), plain_frame(each.child_frame_id)) for each in transforms]
    longest = max((len(frame) for link in links for frame in link), default=0)
    if longest > _LONGEST_NAME:
        raise ValueError(f"expected names of frames of at most {_LONGEST_NAME} characters, found {longest}")
    return links


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
