"""Convert between frames of ROS and ours: the camera's mount by transforms, fixed or moving, and floor poses.

ROS (REP-103): a robot's frame has x forward, y left, z up; a camera's optical frame x right, y down, z forward.
"""

from __future__ import annotations

import math
from array import array
from collections import deque
from collections.abc import Sequence
from heapq import nsmallest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Mount
from localiser.geometry import Array, pose_from_ros, ros_cov_from_cov, wrap_angle

FLOOR_FRAME = "base_footprint"  # REP-120: the robot's frame, let down to the floor; names of many robots have a prefix
MOST_FRAMES, MOST_FRAMES_LIVE = 10_000, 1000  # a bag may hold those of many robots
MOST_STEPS = 100  # from the robot to its camera
MOST_APART_S = 0.5
"""How far from an image the transforms may be that its mount is from."""
_LONGEST_NAME, _MOST_LISTED = 256, 12

_ROBOT_FROM_BASE = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
_OPTICAL_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])
_LARGEST_M = 100.0
LEAST_HEIGHT_M = 1e-3  # of a camera above the floor
_LARGEST_POSITION_M = 1e9
_LARGEST_START_M = 1e8  # from the map's origin, as in a log's start
_LARGEST_SIGMA_M, _LARGEST_SIGMA_RAD = 1000.0, 2 * math.pi
FLOOR_ROWS = np.ix_((0, 1, 5), (0, 1, 5))  # x, y, yaw among x, y, z and the turns about them
_NS = 10**9


Link = tuple[str, str]


class FrameTree:
    """Transforms between named frames: fixed ones, and those that change with time, which are checked when asked for.

    A transform is (4, 4) and takes points of a child to its parent.
    """

    def __init__(self, most: int = MOST_FRAMES, kept: int | None = None) -> None:
        """Start with no frame. most: how many transforms there may be, fixed and moving.

        kept: how many times of each one that moves, the newest; None keeps all.
        """
        self._most, self._kept = most, kept
        self._beside: tuple[dict[str, dict[str, None]], ...] = ({}, {})  # by all, and by fixed ones alone
        self._fixed: dict[Link, Array] = {}
        self._times: dict[Link, array[int]] = {}
        self._values: dict[Link, array[float]] = {}
        self._sorted: dict[Link, tuple[NDArray[np.int64], Array]] = {}
        self._chains: dict[Link, list[Link] | None] = {}

    def add_all(self, transforms: Sequence[Any]) -> None:
        """Add the fixed transforms of a tf2_msgs/TFMessage, all or none.

        Raises ValueError when one is no rigid motion, or there are too many.
        """
        links = self._checked(transforms)
        found = []
        for (parent, child), stamped in zip(links, transforms, strict=True):
            moved, turned = stamped.transform.translation, stamped.transform.rotation
            found.append(_transform((moved.x, moved.y, moved.z), (turned.x, turned.y, turned.z, turned.w)))
            _require_near(parent, child, found[-1])
        for link, transform in zip(links, found, strict=True):
            self._join(link, fixed=True)
            self._fixed[link] = transform

    def add_moving(self, transforms: Sequence[Any], offset_ns: int = 0) -> None:
        """Add transforms as they are at the time of their stamps, all or none; offset_ns: what is added to these.

        Raises ValueError where there are too many.
        """
        for link, stamped in zip(self._checked(transforms), transforms, strict=True):
            self._join(link, fixed=False)
            moved, turned = stamped.transform.translation, stamped.transform.rotation
            times, values = self._times.setdefault(link, array("q")), self._values.setdefault(link, array("d"))
            times.append(stamp_of(stamped) + offset_ns)
            values.extend((moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w))
            if self._kept is not None and len(times) > 1.25 * self._kept:
                del times[: -self._kept], values[: -7 * self._kept]
        self._sorted.clear()

    def forget_times(self) -> None:
        """Forget how frames that move stood to each other, and not which of them do."""
        self._times, self._values = {link: array("q") for link in self._times}, {}
        self._sorted.clear()

    def __contains__(self, frame: str) -> bool:
        return frame in self._beside[0]

    def chain(self, target: str, source: str) -> list[Link] | None:
        """Return the pairs of neighbours from one frame to another, by the fewest transforms; None where none lead.

        Fixed transforms come first where they alone join the two. A chain of more than `MOST_STEPS` is none.
        """
        if (target, source) not in self._chains:
            everything, fixed = self._beside
            self._chains[target, source] = _shortest(fixed, target, source) or _shortest(everything, target, source)
        return self._chains[target, source]

    def moving_links(self, target: str, source: str) -> list[Link]:
        """Return parent and child of the transforms between two frames that change with time."""
        both = (link for step in self.chain(target, source) or () for link in (step, step[::-1]))
        return [link for link in both if link in self._times and link not in self._fixed]

    def reaches(self, link: Link, t_ns: int) -> bool:
        """Whether a transform that moves is known at a time or later."""
        return bool((self._of(link)[0][-1:] >= t_ns).any())

    def between(self, target: str, source: str, t_ns: int = 0) -> Array:
        """Return the transform (4, 4) from `source` to `target` at a time, along any chain. Raises ValueError."""
        steps = self.chain(target, source)
        if steps is None:
            known = ", ".join(nsmallest(_MOST_LISTED, self._beside[0])) or "no frame at all"
            more = ", …" if len(self._beside[0]) > _MOST_LISTED else ""
            raise ValueError(f"expected transforms from {target!r} to {source!r}, found {known}{more}")
        transform: Array = np.eye(4)
        for link in steps:
            known_way = link in self._fixed or (link in self._times and link[::-1] not in self._fixed)
            step = self._at(link, t_ns) if known_way else np.linalg.inv(self._at((link[1], link[0]), t_ns))
            transform = transform @ step
        return transform

    def floor_of(self, base: str) -> str | None:
        """Return the frame of the floor below a robot's frame, which has the same prefix or none; None without one."""
        ends = range(len(base), -1, -1)
        return next((base[:end] + FLOOR_FRAME for end in ends if base[:end] + FLOOR_FRAME in self), None)

    def _checked(self, transforms: Sequence[Any]) -> list[Link]:
        """Return parent and child of each transform. Raises ValueError for too many, and for endless names."""
        links = [(plain_frame(each.header.frame_id), plain_frame(each.child_frame_id)) for each in transforms]
        longest = max((len(frame) for link in links for frame in link), default=0)
        if longest > _LONGEST_NAME:
            raise ValueError(f"expected names of frames of at most {_LONGEST_NAME} characters, found {longest}")
        new = {link for link in links if link not in self._fixed and link not in self._times}
        if len({*self._fixed, *self._times}) + len(new) >= self._most:
            raise ValueError(f"expected fewer than {self._most} transforms between frames, found more")
        return links

    def _join(self, link: Link, *, fixed: bool) -> None:
        for beside in self._beside[: 1 + fixed]:
            for frame, neighbour in (link, link[::-1]):
                if neighbour not in (known := beside.setdefault(frame, {})):
                    known[neighbour] = None
                    self._chains.clear()

    def _at(self, link: Link, t_ns: int) -> Array:
        """Return a transform (4, 4) at a time, between those before and after where it moves. Raises ValueError."""
        if link in self._fixed:
            return self._fixed[link]
        times, values = self._of(link)
        if not len(times):
            raise ValueError(f"expected transforms from {link[0]!r} to {link[1]!r}, found none")
        first, last, share = around(times, t_ns)
        apart_s = max(t_ns - times[first], times[last] - t_ns, key=abs) / 1e9
        if abs(apart_s) > MOST_APART_S and times[first] != t_ns and times[last] != t_ns:
            raise ValueError(
                f"expected transforms from {link[0]!r} to {link[1]!r} within {MOST_APART_S} s of the image at "
                f"{t_ns} ns, found none for {abs(apart_s):.3g} s"
            )
        moved = (1.0 - share) * values[first, :3] + share * values[last, :3]
        transform = _transform(moved, _between(values[first, 3:], values[last, 3:], share))
        _require_near(*link, transform)
        return transform

    def _of(self, link: Link) -> tuple[NDArray[np.int64], Array]:
        if link not in self._sorted:
            times = np.array(self._times[link], dtype=np.int64)
            values = np.array(self._values.get(link, ())).reshape(-1, 7)
            order = np.argsort(times, kind="stable")
            self._sorted[link] = times[order], values[order]
        return self._sorted[link]


def _shortest(beside: dict[str, dict[str, None]], target: str, source: str) -> list[Link] | None:
    """Return the pairs of neighbours from one frame to another; see `FrameTree.chain`."""
    came_from, waiting = {target: target}, deque([target])
    while waiting and source not in came_from:
        frame = waiting.popleft()
        for neighbour in beside.get(frame, ()):
            if neighbour not in came_from:
                came_from[neighbour] = frame
                waiting.append(neighbour)
    steps: list[Link] = []
    frame = source if source in came_from else target
    while frame != target and len(steps) <= MOST_STEPS:
        steps.append((came_from[frame], frame))
        frame = came_from[frame]
    return steps[::-1] if source in came_from and len(steps) <= MOST_STEPS else None


def around(times: NDArray[np.int64], t_ns: int) -> tuple[int, int, float]:
    """Return which of sorted times are before and after a time, and its share of the way from one to the other."""
    after = int(np.searchsorted(times, t_ns))
    first, last = max(after - 1, 0), min(after, len(times) - 1)
    span = float(times[last] - times[first])
    return first, last, float(np.clip((t_ns - times[first]) / span, 0.0, 1.0)) if span > 0 else 0.0


def _transform(moved: Sequence[float] | Array, turned: Sequence[float] | Array) -> Array:
    """Return a transform (4, 4) of a translation and a quaternion (x, y, z, w). Raises ValueError."""
    transform: Array = np.eye(4)
    transform[:3, :3] = rotation_from_quaternion(*turned)
    transform[:3, 3] = moved
    return transform


def _between(one: Array, other: Array, share: float) -> Array:
    """Return the quaternion on the great circle between two, by the share of the way."""
    cos = float(one @ other)
    other, cos = (other, cos) if cos >= 0 else (-other, -cos)
    angle = math.acos(min(cos, 1.0))
    if angle < 1e-6:
        return (1.0 - share) * one + share * other
    weights = math.sin((1.0 - share) * angle) / math.sin(angle), math.sin(share * angle) / math.sin(angle)
    return np.asarray(weights[0] * one + weights[1] * other)


def _require_near(parent: str, child: str, transform: Array) -> None:
    if not (np.abs(transform[:3, 3]) <= _LARGEST_M).all():
        raise ValueError(f"expected {child!r} within {_LARGEST_M:g} m of {parent!r}")


def stamp_of(content: Any) -> int:
    """Return the time (ns) in a message's header."""
    stamp = content.header.stamp
    return int(stamp.sec) * _NS + int(stamp.nanosec)


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


def mount_links(tree: FrameTree, base: str, optical: str) -> list[Link]:
    """Return the transforms that move of those that the mount is made of.

    It moves where the camera does on its robot, or the robot's frame on its footprint, as that of a robot that leans.
    """
    floor = tree.floor_of(base)
    leans = [] if floor is None else tree.moving_links(floor, base)
    return list(dict.fromkeys([*tree.moving_links(base, optical), *leans]))


def mount_of(tree: FrameTree, base: str, optical: str, t_ns: int = 0) -> Mount:
    """Return the mount of the camera with the frame `optical` on the robot with the frame `base` at a time.

    Heights are above the floor's frame where the tree has one, else above `base`. Where the robot's frame leans over
    its footprint, the mount is that on the footprint, which is level. Angles are rounded to 1e-10 degrees and lengths
    to 1e-10 m, far below what can be known, so that writing and reading again changes nothing. Raises ValueError when
    no chain of frames joins the two, or the camera is not above the floor.
    """
    floor = tree.floor_of(base)
    if floor is not None and tree.moving_links(floor, base):
        base = floor
    base_from_optical = tree.between(base, optical, t_ns)
    axes = _ROBOT_FROM_BASE @ base_from_optical[:3, :3] @ _OPTICAL_FROM_CAMERA
    place = _ROBOT_FROM_BASE @ base_from_optical[:3, 3]
    height_m = place[1] if floor is None else tree.between(floor, optical, t_ns)[2, 3]
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


class LostPoseError(ValueError):
    """A pose that its sender did not know."""


def floor_pose(message: Any) -> tuple[float, float, float]:
    """Return x, z, heading of a message of a pose, or of a transform.

    Raises ValueError; LostPoseError where it is null or nan.

    Rounded to 1e-9, as log folders have them, so that converting a log and back changes nothing; wrapped after rounding
    and rounded again: -3.141592654 is less than -π.
    """
    if hasattr(message, "transform"):
        at, turned = message.transform.translation, message.transform.rotation
    else:
        pose = getattr(message.pose, "pose", message.pose)
        at, turned = pose.position, pose.orientation
    quaternion = turned.x, turned.y, turned.z, turned.w
    if not any(quaternion) or math.isnan(sum((at.x, at.y, *quaternion))):
        raise LostPoseError("expected a pose, found one that is null or nan")
    if not (math.hypot(at.x, at.y) <= _LARGEST_POSITION_M):
        raise ValueError(f"expected a position within {_LARGEST_POSITION_M:.0e} m, found x = {at.x}, y = {at.y}")
    rotation = rotation_from_quaternion(*quaternion)
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    x, z, heading = np.round(pose_from_ros([at.x, at.y, yaw]), 9)
    return float(x), float(z), float(np.round(wrap_angle(heading), 9))


def start_of_message(message: Any) -> tuple[Array, Array]:
    """Return the pose (3,) and its covariance (3, 3) where a robot is said to start. Raises ValueError.

    The position is within 100,000 km, sigmas are at most 1000 m and a whole turn.
    """
    mean = np.array(floor_pose(message))
    cov = ros_cov_from_cov(np.asarray(message.pose.covariance, dtype=np.float64).reshape(6, 6)[FLOOR_ROWS])
    if not np.isfinite(cov).all() or not np.allclose(cov, cov.T) or not (np.linalg.eigvalsh(cov) > 0).all():
        raise ValueError("expected a covariance of x, y and yaw that is positive definite")
    cov = (cov + cov.T) / 2
    check_start(mean, cov)
    return mean, cov


def check_start(mean: Array, cov: Array) -> None:
    """Raise ValueError unless a robot can start at a pose (3,) with a covariance (3, 3)."""
    if not (np.abs(mean[:2]) <= _LARGEST_START_M).all():
        raise ValueError(f"expected a start within {_LARGEST_START_M:.0e} m, found x = {mean[0]}, z = {mean[1]}")
    sigma, most = np.sqrt(np.diag(cov)), (_LARGEST_SIGMA_M, _LARGEST_SIGMA_M, _LARGEST_SIGMA_RAD)
    if not (sigma <= most).all():
        raise ValueError(f"expected sigmas of at most {most[0]:g} m and 2π rad, found {', '.join(map(str, sigma))}")
