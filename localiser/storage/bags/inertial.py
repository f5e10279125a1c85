"""Tilt and roll of the camera by an inertial sensor: its own orientation, or gyroscope and accelerometer fused."""

from __future__ import annotations

import math
from array import array
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Mount, MountSigma
from localiser.geometry import Array
from localiser.motion import up_of
from localiser.storage.bags.frames import plain_frame, rotation_from_quaternion, rounded_angle
from localiser.storage.bags.moving_frames import MOST_APART_S

_CAMERA_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0])
_LEAST_SIGMA_RAD = 1e-9  # below it nothing is stated
_UNKNOWN = -1.0  # how ROS says that a sensor has no orientation
_COLUMNS = 20


class Inertial:
    """Messages of one sensor_msgs/Imu topic. frame: of the sensor."""

    def __init__(self) -> None:
        """Start with none."""
        self.frame = ""
        self._times, self._values = array("q"), array("d")
        self._known: tuple[NDArray[np.int64], Array, Array] | None = None

    def __len__(self) -> int:
        return len(self._times)

    def take(self, message: Any, stamp_ns: int) -> None:
        """Add a message. Raises ValueError when its frame changes or a number is not finite."""
        frame = plain_frame(message.header.frame_id)
        if self.frame not in ("", frame):
            raise ValueError(f"expected one inertial sensor, found frames {self.frame!r} and {frame!r}")
        turned, rate, pulled = message.orientation, message.angular_velocity, message.linear_acceleration
        numbers = [turned.x, turned.y, turned.z, turned.w, *np.asarray(message.orientation_covariance)[:9]]
        numbers += [rate.x, rate.y, rate.z, pulled.x, pulled.y, pulled.z]
        if not np.isfinite(numbers).all():
            raise ValueError("expected finite numbers of an inertial sensor, found others")
        self.frame, self._known = frame, None
        self._times.append(stamp_ns)
        self._values.extend([*map(float, numbers), 0.0])

    def mount(self, mount: Mount, optical_from_sensor: Array, t_ns: int) -> Mount:
        """Return the mount with tilt and roll, and their sigmas, as the sensor tells them at a time.

        optical_from_sensor: (3, 3). Raises ValueError where the sensor was silent.
        """
        times, up, cov = self._fused()
        after = int(np.searchsorted(times, t_ns))
        first, last = max(after - 1, 0), min(after, len(times) - 1)
        near = first if t_ns - times[first] <= abs(times[last] - t_ns) else last
        apart_s = abs(int(times[near]) - t_ns) / 1e9
        if apart_s > MOST_APART_S:
            raise ValueError(
                f"expected an inertial sensor within {MOST_APART_S} s of the image at {t_ns} ns, found it silent for "
                f"{apart_s:.3g} s"
            )
        span = float(times[last] - times[first])
        share = float(np.clip((t_ns - times[first]) / span, 0.0, 1.0)) if span > 0 else 0.0
        camera_from_sensor = _CAMERA_FROM_OPTICAL @ optical_from_sensor
        upward = camera_from_sensor @ ((1.0 - share) * up[first] + share * up[last])
        return _leaning(mount, upward / np.linalg.norm(upward), camera_from_sensor @ cov[near] @ camera_from_sensor.T)

    def _fused(self) -> tuple[NDArray[np.int64], Array, Array]:
        """Return times (T,), up (T, 3) in the sensor's axes, and the covariance (T, 3, 3) of turns about these."""
        if self._known is None:
            times = np.array(self._times, dtype=np.int64)
            values = np.array(self._values).reshape(-1, _COLUMNS)
            times, index = np.unique(times, return_index=True)
            values = values[index]
            if (values[:, 4] == _UNKNOWN).any():
                self._known = times, *up_of(times, values[:, 13:16], values[:, 16:19])
            else:
                turned = np.array([rotation_from_quaternion(*row[:4]) for row in values])
                cov = values[:, 4:13].reshape(-1, 3, 3)
                self._known = times, turned[:, 2], np.einsum("tji,tjk,tkl->til", turned, cov, turned)
        return self._known


def _leaning(mount: Mount, up: Array, cov: Array) -> Mount:
    """Return the mount of a camera for which `up` (3,) is up; cov: (3, 3) of turns about its axes (right, up, back).

    Tilt and roll are those with which `Camera.level_from_camera` has that middle row.
    """
    level = math.hypot(up[0], up[1])
    if level < 1e-2:
        raise ValueError("expected a camera that does not look straight up or down")
    by_up = np.array([[0.0, 0.0, 1.0 / level], [-up[1] / level**2, up[0] / level**2, 0.0]])
    turns = np.array([[0.0, -up[2], up[1]], [up[2], 0.0, -up[0]], [-up[1], up[0], 0.0]])
    jacobian = by_up @ turns
    variance = np.maximum(np.diag(jacobian @ cov @ jacobian.T), 0.0)
    tilt, roll = (sigma if sigma > _LEAST_SIGMA_RAD else None for sigma in np.sqrt(variance).tolist())
    known = {"tilt_rad": tilt and rounded_angle(tilt), "roll_rad": roll and rounded_angle(roll)}
    stated = replace(mount.sigma or MountSigma(), **known)
    return replace(
        mount,
        tilt_rad=rounded_angle(math.atan2(up[2], level)),
        roll_rad=rounded_angle(math.atan2(-up[0], up[1])),
        sigma=None if stated == MountSigma() else stated,
    )
