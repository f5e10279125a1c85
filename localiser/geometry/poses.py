"""Angles, poses and motions on the floor, and the same in ROS (REP-103); bearing, slope and lean of a vertical edge.

The last axis of a pose is (x, z, heading), of a point (x, z). Conventions: docs/conventions.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localiser.errors import InputError

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MANY = 256  # angles, from which on a compiled loop is worth calling
_SEVERAL = 64  # angles, from which on it is worth looking whether any needs to be wrapped


def wrap_angle(angle: float | ArrayLike) -> Array:
    """Return the angle (rad) wrapped to [-pi, pi)."""
    if isinstance(angle, float):
        return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
    turned = np.asarray(np.asarray(angle, dtype=np.float64) + np.pi)
    if turned.size >= _SEVERAL and turned.min() >= 0 and turned.max() < 2 * np.pi:
        return np.asarray(turned - np.pi)  # what the remainder would leave as it is, ten times as fast
    return np.asarray(turned % (2 * np.pi) - np.pi)


def wrap_half_turn(angle: ArrayLike) -> Array:
    """Return the angle (rad) of an undirected line wrapped to [-pi/2, pi/2)."""
    return np.asarray((np.asarray(angle, dtype=np.float64) + np.pi / 2) % np.pi - np.pi / 2)


def cos_sin(angle: Array) -> tuple[Array, Array]:
    """Return cosine and sine (N,) of angles (N,), to one bit; of many angles ten times as fast as numpy."""
    if len(angle) < MANY:
        return np.cos(angle), np.sin(angle)
    from localiser.geometry.angle_kernel import cos_sin_of

    cos, sin = cos_sin_of(np.ascontiguousarray(angle))
    return cos, sin


def forward(heading: ArrayLike) -> Array:
    """Return the unit vector (..., 2) straight ahead of a robot with this heading, in the map."""
    return np.stack([-np.sin(heading), -np.cos(heading)], axis=-1)


def right(heading: ArrayLike) -> Array:
    """Return the unit vector (..., 2) to the right of a robot with this heading, in the map."""
    return np.stack([np.cos(heading), -np.sin(heading)], axis=-1)


def map_from_robot(pose: ArrayLike, point_in_robot: ArrayLike) -> Array:
    """Return points (..., 2) of the robot frame in the frame that the poses (..., 3) are given in."""
    pose, point = np.asarray(pose, dtype=np.float64), np.asarray(point_in_robot, dtype=np.float64)
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x, z = point[..., 0], point[..., 1]
    return np.stack([pose[..., 0] + cos * x + sin * z, pose[..., 1] - sin * x + cos * z], axis=-1)


def robot_from_map(pose: ArrayLike, point_in_map: ArrayLike) -> Array:
    """Return points (..., 2) of the map in the frame of robots at `pose` (..., 3); inverse of `map_from_robot`."""
    pose, point = np.asarray(pose, dtype=np.float64), np.asarray(point_in_map, dtype=np.float64)
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    dx, dz = point[..., 0] - pose[..., 0], point[..., 1] - pose[..., 1]
    return np.stack([cos * dx - sin * dz, sin * dx + cos * dz], axis=-1)


def compose(pose: ArrayLike, delta: ArrayLike) -> Array:
    """Return the pose (..., 3) reached from `pose` by the motion `delta` (..., 3), given in the frame of `pose`."""
    pose, delta = np.asarray(pose, dtype=np.float64), np.asarray(delta, dtype=np.float64)
    if pose.size == delta.size == 3 and delta.ndim == 1:  # numbers are five times as fast as arrays of one
        (x, z, heading), (right, back, turn) = pose.ravel().tolist(), delta.tolist()
        cos, sin, turned = math.cos(heading), math.sin(heading), (heading + turn + math.pi) % (2 * math.pi) - math.pi
        return np.array([x + cos * right + sin * back, z - sin * right + cos * back, turned]).reshape(pose.shape)
    moved = np.asarray(pose + delta)
    moved[..., :2] = map_from_robot(pose, delta)
    moved[..., 2] = wrap_angle(moved[..., 2])
    return moved


def between(start: ArrayLike, end: ArrayLike) -> Array:
    """Return the motion (..., 3) that leads from pose `start` to pose `end`, in the frame of `start`."""
    start, end = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    if start.ndim == end.ndim == 1:
        (x, z, heading), (end_x, end_z, end_heading) = start.tolist(), end.tolist()
        cos, sin, dx, dz = math.cos(heading), math.sin(heading), end_x - x, end_z - z
        turn = (end_heading - heading + math.pi) % (2 * math.pi) - math.pi
        return np.array([cos * dx - sin * dz, sin * dx + cos * dz, turn])
    moved = np.asarray(end - start)
    moved[..., :2] = robot_from_map(start, end)
    moved[..., 2] = wrap_angle(moved[..., 2])
    return moved


def arc_log(motion: Array) -> Array:
    """Return the constant velocity (..., 2), right and backward, that takes one unit of time for `motion` (..., 3)."""
    half, x, z = motion[..., 2] / 2, motion[..., 0], motion[..., 1]
    turns = np.where(np.abs(half) < 1e-9, 1.0, half)
    scale = np.where(np.abs(half) < 1e-9, 1.0, turns / np.sin(turns))
    cos, sin = np.cos(half), np.sin(half)
    # The chord points half a turn away from the velocity at the start.
    return np.stack([(cos * x - sin * z) * scale, (sin * x + cos * z) * scale], axis=-1)


def arc_motion(velocity: Array, turn: ArrayLike, duration: ArrayLike) -> Array:
    """Return the motion (..., 3) of moving with `velocity` (..., 2) for a duration (...), turning by `turn` (...)."""
    half, x, z = np.asarray(turn) / 2, velocity[..., 0], velocity[..., 1]
    turns = np.where(np.abs(half) < 1e-9, 1.0, half)
    scale = duration * np.where(np.abs(half) < 1e-9, 1.0, np.sin(turns) / turns)
    cos, sin = np.cos(half), np.sin(half)
    return np.stack([(cos * x + sin * z) * scale, (-sin * x + cos * z) * scale, turn], axis=-1)


# -- a vertical edge under a tilted camera, as [Taylor06] has it: Taylor, Geva, Boles, "Using Camera Tilt to Assist with
# Localisation", ICARA 2006; what only the paper needs is in `paper.slopes`


def is_level(tilt_rad: float) -> bool:
    """Return whether the sine of a tilt is 0, so that a lean tells no bearing."""
    return bool(abs(np.sin(tilt_rad)) < 1e-12)


def sin_of_tilt(tilt_rad: float) -> float:
    """Return the sine of a tilt. Raises ValueError when that is 0."""
    if is_level(tilt_rad):
        raise ValueError("tilt is 0: every vertical edge is vertical in the image, its slope tells no direction")
    return float(np.sin(tilt_rad))


def lean_from_bearing(bearing_rad: ArrayLike, tilt_rad: float) -> Array:
    """Return the lean (rad) of a vertical edge at |bearing| < pi/2: tan(lean) = 1/m = s tan(b) [Taylor06] eq. 7."""
    return np.asarray(np.arctan(np.sin(tilt_rad) * np.tan(bearing_rad)))


def bearing_from_lean(lean_rad: ArrayLike, tilt_rad: float) -> Array:
    """Return the bearing (rad) of a vertical edge: tan(b) = tan(lean) / s [Taylor06] eq. 7. ValueError when s is 0."""
    return np.asarray(np.arctan(np.tan(lean_rad) / sin_of_tilt(tilt_rad)))


def slope_from_lean(lean_rad: ArrayLike) -> Array:
    """Return the paper's slope m = 1 / tan(lean); infinite for a lean of 0."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(1.0 / np.tan(lean_rad))


def bearing_per_lean(bearing_rad: ArrayLike, tilt_rad: float) -> Array:
    """Return J = d(bearing)/d(lean) = (cos²b + s² sin²b) / s. Raises ValueError when the tilt is 0."""
    s = sin_of_tilt(tilt_rad)
    return np.asarray((np.cos(bearing_rad) ** 2 + s**2 * np.sin(bearing_rad) ** 2) / s)


# -- ROS (REP-103) at the border: x forward, y left, z up; yaw anticlockwise from x


def ros_from_pose(pose: ArrayLike) -> Array:
    """Return (x_ros, y_ros, yaw) (..., 3) of poses (..., 3): x_ros = x, y_ros = -z, yaw = heading + pi/2."""
    pose = np.asarray(pose, dtype=np.float64)
    return np.stack([pose[..., 0], -pose[..., 1], wrap_angle(pose[..., 2] + np.pi / 2)], axis=-1)


def pose_from_ros(ros: ArrayLike) -> Array:
    """Return poses (..., 3) of (x_ros, y_ros, yaw) (..., 3); inverse of `ros_from_pose`."""
    ros = np.asarray(ros, dtype=np.float64)
    return np.stack([ros[..., 0], -ros[..., 1], wrap_angle(ros[..., 2] - np.pi / 2)], axis=-1)


def ros_cov_from_cov(cov: ArrayLike) -> Array:
    """Return covariances (..., 3, 3) of (x_ros, y_ros, yaw) from those of (x, z, heading); its own inverse."""
    sign = np.array([1.0, -1.0, 1.0])
    return np.asarray(np.asarray(cov, dtype=np.float64) * sign[:, None] * sign[None, :])


@dataclass(frozen=True, slots=True, eq=False)
class Increment:
    """A motion of the robot between two instants, from wheels or from vision.

    mean: (3,) motion (right m, backward m, turn rad) in the robot frame at the first instant.
    cov: (3, 3) covariance of `mean`, but for the noise of wheels that the motion model knows.
    path_m, turned_rad: how far the robot drove and turned on the way, which is more than `mean` where it went to and
        fro; the motion model's noise grows with these.
    told: (2,) the parts of path_m and turned_rad whose noise is in `cov`.
    by_delay: (3,) how `mean` changes per second by which the robot is later than its odometry.
    """

    mean: Array
    cov: Array
    path_m: float
    turned_rad: float
    by_delay: Array = field(default_factory=lambda: np.zeros(3))
    told: Array = field(default_factory=lambda: np.zeros(2))

    @classmethod
    def from_mean(cls, mean: ArrayLike, cov: ArrayLike | None = None) -> Increment:
        """Return the increment of one straight move: path and turn are those of `mean` (3,)."""
        mean = np.asarray(mean, dtype=np.float64)
        path_m, turned_rad = float(np.hypot(mean[0], mean[1])), float(abs(mean[2]))
        if cov is None:
            return cls(mean, np.zeros((3, 3)), path_m, turned_rad)
        return cls(mean, np.asarray(cov, dtype=np.float64), path_m, turned_rad, told=np.array([path_m, turned_rad]))

    def then(self, later: Increment) -> Increment:
        """Return this motion followed by `later`; covariances are carried to first order.

        cov = A cov_1 Aᵀ + B cov_2 Bᵀ with A = ∂(1 ∘ 2)/∂1 and B = ∂(1 ∘ 2)/∂2 [Smith, Self, Cheeseman 1990].
        """
        cos, sin = np.cos(self.mean[2]), np.sin(self.mean[2])
        x, z = later.mean[0], later.mean[1]
        jac_self = np.array([[1.0, 0.0, -sin * x + cos * z], [0.0, 1.0, -cos * x - sin * z], [0.0, 0.0, 1.0]])
        jac_later = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        cov = jac_self @ self.cov @ jac_self.T + jac_later @ later.cov @ jac_later.T
        path_m, turned_rad = float(self.path_m + later.path_m), float(self.turned_rad + later.turned_rad)
        by_delay = jac_self @ self.by_delay + jac_later @ later.by_delay
        return Increment(compose(self.mean, later.mean), cov, path_m, turned_rad, by_delay, self.told + later.told)

    def since(self, earlier: Increment) -> Increment:
        """Return what of this motion came after `earlier`, its beginning; of the covariance the turn's variance."""
        cov = np.zeros((3, 3))
        cov[2, 2] = max(self.cov[2, 2] - earlier.cov[2, 2], 0.0)  # turns add up
        path_m, turned_rad = self.path_m - earlier.path_m, self.turned_rad - earlier.turned_rad
        return Increment(between(earlier.mean, self.mean), cov, path_m, turned_rad, told=self.told - earlier.told)


def finite_numbers(name: str, values: ArrayLike, *shapes: tuple[int | str, ...]) -> Array:
    """Return finite numbers as a new array of one of the shapes; ("E",) is any length. Raises InputError of `name`."""
    try:
        found = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.array(np.nan)
    fits = found.shape in shapes or (found.ndim == 1 and ("E",) in shapes)
    if not fits or not np.isfinite(found).all():
        expected = " or ".join(str(shape).replace("'", "") if shape else "one" for shape in shapes)
        raise InputError(f"expected {expected} finite numbers, found {values!r}", field=name)
    return found
