"""Floor poses, increments, angles, and the equations of the paper as plain functions.

Frames and signs (docs/conventions.md). Robot and camera: x right, y up, z backward. Map: right-handed, y up,
the floor is the (x, z) plane. A pose is (x, z, heading); heading turns about +y, anticlockwise seen from above,
and is 0 when the robot faces map -z. Bearing is positive to the right. Lean is the angle of an image line from the
image vertical, positive when the top leans right; the paper's slope is m = 1 / tan(lean).

[Taylor06] is Taylor, Geva, Boles, "Using Camera Tilt to Assist with Localisation", ICARA 2006.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

MANY = 256  # angles, from which on a compiled loop is worth calling

# -- Angles -----------------------------------------------------------------------------------------------------------


def wrap_angle(angle: ArrayLike) -> Array:
    """Return the angle (rad) wrapped to [-pi, pi)."""
    turned = np.asarray(np.asarray(angle, dtype=np.float64) + np.pi)
    if turned.ndim and turned.size and turned.min() >= 0 and turned.max() < 2 * np.pi:
        return np.asarray(turned - np.pi)  # what the remainder would leave as it is, ten times as fast
    return np.asarray(turned % (2 * np.pi) - np.pi)


def wrap_half_turn(angle: ArrayLike) -> Array:
    """Return the angle (rad) of an undirected line wrapped to [-pi/2, pi/2)."""
    return np.asarray((np.asarray(angle, dtype=np.float64) + np.pi / 2) % np.pi - np.pi / 2)


def cos_sin(angle: Array) -> tuple[Array, Array]:
    """Return cosine and sine (N,) of angles (N,), to one bit; of many angles ten times as fast as numpy."""
    if len(angle) < MANY:
        return np.cos(angle), np.sin(angle)
    from localiser.turning import cos_sin_of

    cos, sin = cos_sin_of(np.ascontiguousarray(angle))
    return cos, sin


def circular_mean(angles: ArrayLike, weights: ArrayLike | None = None) -> float:
    """Return the direction (rad) of the weighted mean vector of unit vectors at `angles`."""
    angles = np.asarray(angles, dtype=np.float64)
    weights = np.ones_like(angles) if weights is None else np.asarray(weights, dtype=np.float64)
    cos, sin = cos_sin(angles)
    return float(np.arctan2(weights @ sin, weights @ cos))


# -- Floor poses; the last axis of every pose is (x, z, heading), of every point (x, z) -------------------------------


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
    heading = wrap_angle(pose[..., 2] + delta[..., 2])
    return np.concatenate([map_from_robot(pose, delta[..., :2]), heading[..., None]], axis=-1)


def between(start: ArrayLike, end: ArrayLike) -> Array:
    """Return the motion (..., 3) that leads from pose `start` to pose `end`, in the frame of `start`."""
    start, end = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    turn = wrap_angle(end[..., 2] - start[..., 2])
    return np.concatenate([robot_from_map(start, end[..., :2]), turn[..., None]], axis=-1)


def interpolate_pose(start: ArrayLike, end: ArrayLike, fraction: float) -> Array:
    """Return the pose at `fraction` of the way from `start` to `end` (3,), along the arc that joins them.

    The body twist is constant on the way, so a robot that drives a circle is found on the circle, not on its chord;
    headings may lie on both sides of ±pi.
    """
    motion = between(start, end)
    turn = float(motion[2])
    return compose(start, arc_motion(arc_log(motion), turn * fraction, fraction))


def arc_log(motion: Array) -> Array:
    """Return the constant velocity (right, backward) per unit time that `motion` (3,) takes one unit of time for."""
    half = float(motion[2]) / 2
    scale = 1.0 if abs(half) < 1e-9 else half / np.sin(half)
    cos, sin = np.cos(half), np.sin(half)
    # The chord points half a turn away from the velocity at the start.
    x, z = float(motion[0]), float(motion[1])
    return np.array([cos * x - sin * z, sin * x + cos * z]) * scale


def arc_motion(velocity: Array, turn: float, duration: float) -> Array:
    """Return the motion (3,) of moving with `velocity` (right, backward) for `duration` while turning by `turn`."""
    half = turn / 2
    scale = duration * (1.0 if abs(half) < 1e-9 else np.sin(half) / half)
    cos, sin = np.cos(half), np.sin(half)
    x, z = velocity
    return np.array([(cos * x + sin * z) * scale, (-sin * x + cos * z) * scale, turn])


@dataclass(frozen=True, slots=True, eq=False)
class Increment:
    """A motion of the robot between two instants, from wheels, from vision, or from both.

    mean: (3,) motion (right m, backward m, turn rad) in the robot frame at the first instant.
    cov: (3, 3) covariance of `mean`; zeros leave the noise to the motion model.
    path_m, turned_rad: how far the robot drove and turned on the way, which is more than `mean` where it went to and
        fro; the motion model's noise grows with these.
    source: "wheel", "vision" or "both".
    by_delay: (3,) how `mean` changes per second by which the robot is later than its odometry.
    """

    mean: Array
    cov: Array
    path_m: float
    turned_rad: float
    source: str
    by_delay: Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def from_mean(cls, mean: ArrayLike, source: str = "wheel", cov: ArrayLike | None = None) -> Increment:
        """Return the increment of one straight move: path and turn are those of `mean` (3,)."""
        mean = np.asarray(mean, dtype=np.float64)
        cov = np.zeros((3, 3)) if cov is None else np.asarray(cov, dtype=np.float64)
        return cls(mean, cov, float(np.hypot(mean[0], mean[1])), float(abs(mean[2])), source)

    def then(self, later: Increment) -> Increment:
        """Return this motion followed by `later`; covariances are carried to first order.

        cov = A cov_1 Aᵀ + B cov_2 Bᵀ with A = ∂(1 ∘ 2)/∂1 and B = ∂(1 ∘ 2)/∂2 [Smith, Self, Cheeseman 1990].
        """
        cos, sin = np.cos(self.mean[2]), np.sin(self.mean[2])
        x, z = later.mean[0], later.mean[1]
        jac_self = np.array([[1.0, 0.0, -sin * x + cos * z], [0.0, 1.0, -cos * x - sin * z], [0.0, 0.0, 1.0]])
        jac_later = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        cov = jac_self @ self.cov @ jac_self.T + jac_later @ later.cov @ jac_later.T
        source = self.source if self.source == later.source else "both"
        return Increment(
            compose(self.mean, later.mean),
            cov,
            self.path_m + later.path_m,
            self.turned_rad + later.turned_rad,
            source,
            jac_self @ self.by_delay + jac_later @ later.by_delay,
        )


# -- ROS (REP-103) at the border: x forward, y left, z up; yaw anticlockwise from x -----------------------------------


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


# -- Bearing, slope and lean of a vertical edge under tilt ------------------------------------------------------------


def _sin_of_tilt(tilt_rad: float) -> float:
    sine = float(np.sin(tilt_rad))
    if abs(sine) < 1e-12:
        raise ValueError("tilt is 0: every vertical edge is vertical in the image, its slope tells no direction")
    return sine


def bearing_from_point(x: ArrayLike, z: ArrayLike) -> Array:
    """Return the bearing (rad, positive right) of a point (x, z) of the camera's level frame; ±pi/2 beside it."""
    return np.asarray(np.arctan2(x, -np.asarray(z, dtype=np.float64)))


def slope_from_point(x: ArrayLike, z: ArrayLike, tilt_rad: float) -> Array:
    """Return the paper's slope m = -z / (x s) of the vertical edge at (x, z); infinite straight ahead.

    [Taylor06] eq. 7.
    """
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(-np.asarray(z, dtype=np.float64) / (np.asarray(x, dtype=np.float64) * _sin_of_tilt(tilt_rad)))


def lean_from_bearing(bearing_rad: ArrayLike, tilt_rad: float) -> Array:
    """Return the lean (rad) of a vertical edge at this bearing: tan(lean) = s tan(b), 0 for every b when s = 0.

    [Taylor06] eq. 7 with lean = atan(1/m), finite everywhere for |b| < pi/2.
    """
    return np.asarray(np.arctan(np.sin(tilt_rad) * np.tan(bearing_rad)))


def bearing_from_lean(lean_rad: ArrayLike, tilt_rad: float) -> Array:
    """Return the bearing (rad) in (-pi/2, pi/2) of a vertical edge from its lean: tan(b) = tan(lean) / s.

    Raises ValueError when the tilt is 0, where lean says nothing. [Taylor06] eq. 7.
    """
    return np.asarray(np.arctan(np.tan(lean_rad) / _sin_of_tilt(tilt_rad)))


def slope_from_lean(lean_rad: ArrayLike) -> Array:
    """Return the paper's slope m = 1 / tan(lean); infinite for a lean of 0."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(1.0 / np.tan(lean_rad))


def lean_from_slope(slope: ArrayLike) -> Array:
    """Return the lean = atan(1/m) in [-pi/2, pi/2]; 0 for an infinite slope."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(np.arctan(1.0 / np.asarray(slope, dtype=np.float64)))


def nadir_point(tilt_rad: float) -> Array:
    """Return the image point (a, e) (2,) where all vertical edges meet: (0, -c/s).

    a is normalised to the right, e upwards, without roll. Raises ValueError when the tilt is 0 (point at infinity).
    """
    return np.array([0.0, -np.cos(tilt_rad) / _sin_of_tilt(tilt_rad)])


def edge_a_at(e: ArrayLike, bearing_rad: ArrayLike, tilt_rad: float) -> Array:
    """Return where the vertical edge at this bearing crosses the image height e: a = tan(b) (c + e s)."""
    e = np.asarray(e, dtype=np.float64)
    return np.asarray(np.tan(bearing_rad) * (np.cos(tilt_rad) + e * np.sin(tilt_rad)))


def bearing_of_image_point(a: ArrayLike, e: ArrayLike, tilt_rad: float) -> Array:
    """Return the bearing (rad) of the vertical edge through the image point (a, e): tan(b) = a / (c + e s).

    Points at or below the nadir point (c + e s <= 0) see the floor behind the camera; their bearing exceeds pi/2.
    """
    e = np.asarray(e, dtype=np.float64)
    return np.asarray(np.arctan2(a, np.cos(tilt_rad) + e * np.sin(tilt_rad)))


# -- Two views of one edge (section 3 of the paper) -------------------------------------------------------------------


def rotation_from_slopes(slope_1: ArrayLike, slope_2: ArrayLike, tilt_rad: float) -> Array:
    """Return the turn psi (rad) between two views of one edge by a camera that turned on the spot.

    psi = atan(m1 s) - atan(m2 s), unwrapped by pi where the edge crosses the image centre and m changes its sign.
    Equal to b2 - b1, so positive when the robot turned left (anticlockwise). [Taylor06] eq. 13.
    """
    s = _sin_of_tilt(tilt_rad)
    return wrap_half_turn(np.arctan(np.asarray(slope_1) * s) - np.arctan(np.asarray(slope_2) * s))


def depth_from_slopes(slope_1: ArrayLike, slope_2: ArrayLike, motion_m: ArrayLike) -> Array:
    """Return z1 of an edge seen before and after a straight motion d = z1 - z2: z1 = d m1 / (m1 - m2).

    d < 0 when driving forward. An edge straight ahead gives nan, which is the truth: it tells nothing.
    [Taylor06] eq. 10.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.asarray(motion_m, dtype=np.float64) / _motion_per_depth(slope_1, slope_2))


def motion_from_slopes(slope_1: ArrayLike, slope_2: ArrayLike, depth_1_m: ArrayLike) -> Array:
    """Return the motion d = z1 - z2 along the robot's axis from one edge of known z1: d = (1 - m2/m1) z1.

    nan for an edge straight ahead. [Taylor06] eq. 11.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(np.asarray(depth_1_m, dtype=np.float64) * _motion_per_depth(slope_1, slope_2))


def _motion_per_depth(slope_1: ArrayLike, slope_2: ArrayLike) -> Array:
    """Return d / z1 = 1 - m2/m1; right beside the camera (m2 = 0), nan straight ahead (both infinite)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(1.0 - np.asarray(slope_2, dtype=np.float64) / np.asarray(slope_1, dtype=np.float64))


# -- How certain a bearing is -----------------------------------------------------------------------------------------


def bearing_per_lean(bearing_rad: ArrayLike, tilt_rad: float) -> Array:
    """Return J = d(bearing)/d(lean) = (cos²b + s² sin²b) / s. Raises ValueError when the tilt is 0."""
    s = _sin_of_tilt(tilt_rad)
    return np.asarray((np.cos(bearing_rad) ** 2 + s**2 * np.sin(bearing_rad) ** 2) / s)


def lean_sigma_of_segment(length_px: ArrayLike, endpoint_sigma_px: ArrayLike) -> Array:
    """Return the sigma (rad) of a segment's lean whose two ends err by `endpoint_sigma_px` across it: √2 σ / L."""
    return np.asarray(np.sqrt(2.0) * np.asarray(endpoint_sigma_px) / np.asarray(length_px))


def constrained_lean_sigma(length_px: ArrayLike, nadir_distance_px: ArrayLike, endpoint_sigma_px: ArrayLike) -> Array:
    """Return the sigma (rad) of the lean of a line held through the nadir point: σ / √(2 D² + L²/2).

    D is the distance of the segment's middle from the nadir point (design equation 7). Times J: sigma of the bearing.
    """
    length, distance = np.asarray(length_px, dtype=np.float64), np.asarray(nadir_distance_px, dtype=np.float64)
    return np.asarray(np.asarray(endpoint_sigma_px) / np.sqrt(2 * distance**2 + length**2 / 2))


def bearing_per_tilt_from_lean(bearing_rad: ArrayLike, tilt_rad: float) -> Array:
    """Return d(bearing)/d(tilt) of a bearing computed from lean alone: -½ sin(2b) cot(tilt).

    Raises ValueError when the tilt is 0.
    """
    return np.asarray(-0.5 * np.sin(2 * np.asarray(bearing_rad)) * np.cos(tilt_rad) / _sin_of_tilt(tilt_rad))


# -- Floor contact of an edge (inverse perspective mapping) -----------------------------------------------------------


def floor_range(height_m: ArrayLike, depression_rad: ArrayLike) -> Array:
    """Return the floor distance r = h / tan(depression) of a point seen below the horizon; inf at it, nan above."""
    tangent = np.tan(depression_rad)
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(tangent < 0, np.nan, np.asarray(height_m) / tangent))


def floor_range_sigma(height_m: ArrayLike, range_m: ArrayLike, depression_sigma_rad: ArrayLike) -> Array:
    """Return the sigma (m) of `floor_range`: (r² + h²) / h · sigma_depression."""
    r, h = np.asarray(range_m, dtype=np.float64), np.asarray(height_m, dtype=np.float64)
    return np.asarray((r**2 + h**2) / h * np.asarray(depression_sigma_rad))


# -- Trajectories -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses over time. t_ns: (T,) int64, strictly increasing. poses: (T, 3) x, z, heading."""

    t_ns: NDArray[np.int64]
    poses: Array

    def __len__(self) -> int:
        return len(self.t_ns)

    def covers(self, t_ns: int) -> bool:
        """Whether `t_ns` lies between the first and the last pose."""
        return len(self) > 0 and int(self.t_ns[0]) <= t_ns <= int(self.t_ns[-1])

    def at(self, t_ns: int) -> Array:
        """Return the pose (3,) at a time, interpolated along the arc; the first or last pose outside."""
        after = int(np.searchsorted(self.t_ns, t_ns, side="left"))
        if after == 0:
            return np.asarray(self.poses[0].copy())
        if after == len(self):
            return np.asarray(self.poses[-1].copy())
        start_ns, end_ns = int(self.t_ns[after - 1]), int(self.t_ns[after])
        return interpolate_pose(self.poses[after - 1], self.poses[after], (t_ns - start_ns) / (end_ns - start_ns))

    def sampled(self, times_ns: ArrayLike) -> Trajectory:
        """Return the trajectory at the given times (T',)."""
        times = np.asarray(times_ns, dtype=np.int64)
        poses = np.array([self.at(int(t)) for t in times]).reshape(-1, 3)
        return Trajectory(times, poses)
