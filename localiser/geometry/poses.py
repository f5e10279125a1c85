"""Poses on the floor, and the same in ROS (REP-103). The last axis of a pose is (x, z, heading), of a point (x, z).

Conventions: docs/conventions.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from localiser.geometry.angles import Array, wrap_angle


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
    if pose.size == delta.size == 3 and delta.ndim == 1:
        return _composed(*pose.ravel().tolist(), *delta.tolist()).reshape(pose.shape)
    heading = wrap_angle(pose[..., 2] + delta[..., 2])
    return np.concatenate([map_from_robot(pose, delta[..., :2]), heading[..., None]], axis=-1)


def between(start: ArrayLike, end: ArrayLike) -> Array:
    """Return the motion (..., 3) that leads from pose `start` to pose `end`, in the frame of `start`."""
    start, end = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    if start.ndim == end.ndim == 1:
        return _between(*start.tolist(), *end.tolist())
    turn = wrap_angle(end[..., 2] - start[..., 2])
    return np.concatenate([robot_from_map(start, end[..., :2]), turn[..., None]], axis=-1)


def _composed(x: float, z: float, heading: float, right: float, back: float, turn: float) -> Array:
    """Return what `compose` does of one pose: numbers are five times as fast as arrays of one."""
    cos, sin = np.cos(heading), np.sin(heading)
    return np.array([x + cos * right + sin * back, z - sin * right + cos * back, wrap_angle(heading + turn)])


def _between(x: float, z: float, heading: float, end_x: float, end_z: float, end_heading: float) -> Array:
    """Return what `between` does of two poses."""
    cos, sin, dx, dz = np.cos(heading), np.sin(heading), end_x - x, end_z - z
    return np.array([cos * dx - sin * dz, sin * dx + cos * dz, wrap_angle(end_heading - heading)])


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
