"""Which way is up, by an inertial sensor: gyroscope and accelerometer fused by a Kalman filter.

The accelerometer of a sensor that does not accelerate points up; the gyroscope tells how that turns. The filter
estimates the error of the attitude and the gyroscope's constant rate error, three states each, about the attitude that
the gyroscope integrates [Sola 2017, "Quaternion kinematics for the error-state Kalman filter", chapter 5]:

    up' = up - (rate - bias) × up dt,    acceleration / |acceleration| = up + noise

A robot that speeds up or turns pulls the accelerometer away from up for about a second, so its samples err together.
Where its length is not that of gravity, it counts for less.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array

GRAVITY_M_S2 = 9.80665
_RATE_PER_SQRT_S = 2e-3  # error of the gyroscope, rad/√s
_BIAS_RAD_S, _BIAS_PER_SQRT_S = 0.01, 1e-4  # its constant error, and how fast that walks
_ACCELERATING, _CORRELATED_S = 0.03, 1.0  # of the robot, as a part of gravity, for about so long at a time
_FALLING = 0.1  # of gravity, below which what is measured does not tell which way is up
_BEGIN_NS = 50_000_000  # of the first samples that say which way is up, before the robot can have leant


def up_of(t_ns: NDArray[np.int64], rate_rad_s: Array, acceleration_m_s2: Array) -> tuple[Array, Array]:
    """Return which way is up (T, 3) in the sensor's axes, unit vectors, and the covariance of its attitude (T, 3, 3).

    t_ns: (T,) ascending. rate_rad_s, acceleration_m_s2: (T, 3) as measured; at rest the acceleration points up, as
    ROS has it. The covariance is of small turns about the sensor's axes, rad².
    """
    up, cov = np.empty((len(t_ns), 3)), np.empty((len(t_ns), 3, 3))
    held = np.flatnonzero(np.linalg.norm(acceleration_m_s2, axis=1) >= _FALLING * GRAVITY_M_S2)
    if not len(held):
        raise ValueError("expected an accelerometer that measures gravity, found none of it")
    first = acceleration_m_s2[held[t_ns[held] < t_ns[held[0]] + _BEGIN_NS]].mean(axis=0)
    first /= np.linalg.norm(first)
    side = np.cross(first, np.eye(3)[int(np.abs(first).argmin())])
    side /= np.linalg.norm(side)
    attitude = np.array([side, np.cross(first, side), first])  # level from sensor; its heading is any
    bias = np.zeros(3)
    p = np.diag([_ACCELERATING**2] * 3 + [_BIAS_RAD_S**2] * 3)
    for k, t in enumerate(t_ns):
        step_s = 0.0 if k == 0 else float(t - t_ns[k - 1]) / 1e9
        if k:
            turning = cv2.Rodrigues(((rate_rad_s[k] + rate_rad_s[k - 1]) / 2 - bias) * step_s)[0]
            f = np.eye(6)
            f[:3, :3], f[:3, 3:] = turning.T, -step_s * np.eye(3)
            q = np.repeat([_RATE_PER_SQRT_S**2 * step_s, _BIAS_PER_SQRT_S**2 * step_s], 3)
            attitude, p = attitude @ turning, f @ p @ f.T + np.diag(q)
        length = float(np.linalg.norm(acceleration_m_s2[k]))
        if length >= _FALLING * GRAVITY_M_S2:
            x, y, z = attitude[2]
            h = np.zeros((3, 6))
            h[:, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]  # the cross product with up
            variance = _ACCELERATING**2 + (length / GRAVITY_M_S2 - 1.0) ** 2
            variance *= max(_CORRELATED_S / max(step_s, 1e-3), 1.0)  # samples within that time err together
            gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + variance * np.eye(3))
            change = gain @ (acceleration_m_s2[k] / length - attitude[2])
            p = (np.eye(6) - gain @ h) @ p
            attitude, bias, p = attitude @ cv2.Rodrigues(change[:3])[0], bias + change[3:], (p + p.T) / 2
        up[k], cov[k] = attitude[2], p[:3, :3]
    return up, cov
