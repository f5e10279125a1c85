"""A rolling shutter undone: edges as a camera that takes all rows at once would have found them.

While the rows of an image are taken one after another, the robot turns and drives. An edge at bearing b and floor
range r then moves by

    db/dt = turn rate + (ahead · sin b - right · cos b) / r

with the velocity (ahead, right) of the camera. So each point of it is turned about the vertical, by what the edge has
moved between the image's time stamp and the time of the point's row. At 1 rad/s and 30 ms from the first row to the
last, a vertical edge leans by 1.7° otherwise. Turning moves all edges alike. What driving does depends on the range,
which an edge's lower end tells if it stands on the floor; it cannot be farther away than that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser import geometry
from localiser.camera import Camera
from localiser.edges.views import ideal_camera
from localiser.geometry import UNKNOWN_TWIST, Array, Twist

_TYPICAL_INVERSE_RANGE = 0.4
"""1/m, of edges whose lower end is above the horizon: rooms are some metres wide."""
_INVERSE_RANGE_SIGMA = 0.3
"""1/m: lower ends need not stand on the floor."""
_STEP_RAD_S = 1e-3
"""Change of the turn rate by which derivatives are taken."""
_ITERATIONS = 4
"""Of finding the row in which a point was taken; each is ten times closer at least up to 4 rad/s and 30 ms."""


@dataclass(frozen=True, slots=True, eq=False)
class Readout:
    """How a camera with a rolling shutter moved while it took one image.

    velocity: (right, backward) m/s in the level frame, turn_rad_s: anticlockwise, turn_sigma_rad_s: its sigma.
    """

    camera: Camera
    velocity: Array
    turn_rad_s: float
    turn_sigma_rad_s: float

    def rates(self, ends_px: Array) -> tuple[Array, Array]:
        """Return d(bearing)/dt (S,) rad/s of segments with ends (S, 2, 2), undistorted, bottom first, and its sigma.

        The sigma is that of the unknown range alone; an error of the turn rate is the same for all.
        """
        rays = self._rays(ends_px[:, 0])
        across, ahead = rays[:, 0], -rays[:, 2]
        bearing = np.arctan2(across, ahead)
        inverse = -rays[:, 1] / np.hypot(across, ahead) / self.camera.mount.height_m
        inverse = np.where(inverse > 0, inverse, _TYPICAL_INVERSE_RANGE)
        right, backward = self.velocity
        passing = -backward * np.sin(bearing) - right * np.cos(bearing)
        return self.turn_rad_s + passing * inverse, np.abs(passing) * _INVERSE_RANGE_SIGMA

    def at_stamp(self, taken_px: Array, rate: Array) -> Array:
        """Return where points (S, …, 2) that were taken would be at the time stamp, if they move at `rate` (S,)."""
        return self._turned(taken_px, -_along(rate, taken_px) * self._since_stamp_s(taken_px))

    def as_taken(self, stamp_px: Array, rate: Array) -> Array:
        """Return where points (S, …, 2) of the time stamp were taken; inverse of `at_stamp`."""
        taken = stamp_px
        for _ in range(_ITERATIONS):
            taken = self._turned(stamp_px, _along(rate, stamp_px) * self._since_stamp_s(taken))
        return taken

    def moved(self, stamp_px: Array, rate: Array) -> Array:
        """Return where points (S, 2, 2) would be by a turn rate that is larger by `_STEP_RAD_S`."""
        since_s = self._since_stamp_s(self.as_taken(stamp_px, rate))
        return self._turned(stamp_px, -_STEP_RAD_S * since_s)

    def turn_of(self, ends_px: Array, rate: Array) -> Array:
        """Return d(lean)/d(turn rate) (S,), s, of segments with ends (S, 2, 2) at the time stamp."""
        ideal = ideal_camera(self.camera)
        change = ideal.lean_of_segments(self.moved(ends_px, rate)) - ideal.lean_of_segments(ends_px)
        return np.asarray(geometry.wrap_half_turn(change) / _STEP_RAD_S)

    def shift_of(self, ends_px: Array, rate: Array) -> Array:
        """Return d(bearing)/d(turn rate) (S,), s, of lines through the nadir point, as `turn_of`."""
        ideal = ideal_camera(self.camera)
        change = ideal.bearing_of_segments(self.moved(ends_px, rate)) - ideal.bearing_of_segments(ends_px)
        return np.asarray(change / _STEP_RAD_S)

    def _since_stamp_s(self, ideal_px: Array) -> Array:
        """Return when the rows of undistorted points (..., 2) are taken, after the time stamp."""
        assert self.camera.shutter is not None
        taken = self.camera.pixels_from_image(ideal_camera(self.camera).image_from_pixels(ideal_px))
        return self.camera.shutter.since_stamp_s(taken[..., 1])

    def _rays(self, ideal_px: Array) -> Array:
        return ideal_camera(self.camera).level_rays(ideal_px)

    def _turned(self, ideal_px: Array, bearing_rad: Array) -> Array:
        """Return undistorted points (..., 2) turned about the vertical, towards larger bearings by angles (...)."""
        x, y, z = np.moveaxis(self._rays(ideal_px), -1, 0)
        cos, sin = np.cos(bearing_rad), np.sin(bearing_rad)
        level = np.stack([cos * x - sin * z, y, sin * x + cos * z], axis=-1)
        right, up, backward = np.moveaxis(level @ self.camera.level_from_camera, -1, 0)
        ideal = ideal_camera(self.camera)
        return ideal.pixels_from_image(np.stack([right, up], axis=-1) / -backward[..., None])


def _along(rate: Array, points: Array) -> Array:
    """Return rates (S,) so that they multiply values of points (S, …, 2)."""
    return rate.reshape(-1, *[1] * (points.ndim - 2))


def readout_of(camera: Camera, twist: Twist | None) -> Readout | None:
    """Return how a camera moved while it took an image, by the twist of its robot; None where all rows are one time.

    camera: as it was mounted then. twist: None where nothing says how the robot moved.
    """
    if camera.shutter is None:
        return None
    twist = twist or UNKNOWN_TWIST
    mount, turn = camera.mount, twist.turn_rad_s
    in_robot = np.array([twist.right_m_s + turn * mount.back_m, twist.backward_m_s - turn * mount.right_m])
    velocity = geometry.robot_from_map(np.array([0.0, 0.0, mount.yaw_rad]), in_robot)
    return Readout(camera, velocity, turn, twist.turn_sigma_rad_s)
