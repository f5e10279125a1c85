"""Floor poses out of ROS messages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from localiser.geometry import Array, pose_from_ros, ros_cov_from_cov, wrap_angle
from localiser.storage.bags.frames import rotation_from_quaternion

_LARGEST_M = 1e9
FLOOR_ROWS = np.ix_((0, 1, 5), (0, 1, 5))  # x, y, yaw among x, y, z and the turns about them


def floor_pose(message: Any) -> tuple[float, float, float]:
    """Return x, z, heading of a nav_msgs/Odometry or a PoseWithCovarianceStamped. Raises ValueError.

    Rounded to 1e-9, as log folders have them, so that converting a log and back changes nothing; wrapped after rounding
    and rounded again: -3.141592654 is less than -π.
    """
    pose = message.pose.pose
    at, turned = pose.position, pose.orientation
    if not (math.hypot(at.x, at.y) <= _LARGEST_M):
        raise ValueError(f"expected a position within {_LARGEST_M:.0e} m, found x = {at.x}, y = {at.y}")
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
