"""The paper's equations that the program itself does without: slopes of points, and two views of one edge.

[Taylor06] is Taylor, Geva, Boles, "Using Camera Tilt to Assist with Localisation", ICARA 2006.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from localiser.geometry import Array, sin_of_tilt, wrap_half_turn


def slope_from_point(x: ArrayLike, z: ArrayLike, tilt_rad: float) -> Array:
    """Return the paper's slope m = -z / (x s) of the vertical edge at (x, z); infinite straight ahead.

    [Taylor06] eq. 7.
    """
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(-np.asarray(z, dtype=np.float64) / (np.asarray(x, dtype=np.float64) * sin_of_tilt(tilt_rad)))


def lean_from_slope(slope: ArrayLike) -> Array:
    """Return the lean = atan(1/m) in [-pi/2, pi/2]; 0 for an infinite slope."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(np.arctan(1.0 / np.asarray(slope, dtype=np.float64)))


def bearing_of_image_point(a: ArrayLike, e: ArrayLike, tilt_rad: float) -> Array:
    """Return the bearing (rad) of the vertical edge through the image point (a, e): tan(b) = a / (c + e s).

    Points at or below the nadir point (c + e s <= 0) see the floor behind the camera; their bearing exceeds pi/2.
    """
    e = np.asarray(e, dtype=np.float64)
    return np.asarray(np.arctan2(a, np.cos(tilt_rad) + e * np.sin(tilt_rad)))


def rotation_from_slopes(slope_1: ArrayLike, slope_2: ArrayLike, tilt_rad: float) -> Array:
    """Return the turn psi (rad) between two views of one edge by a camera that turned on the spot.

    psi = atan(m1 s) - atan(m2 s), unwrapped by pi where the edge crosses the image centre and m changes its sign.
    Equal to b2 - b1, so positive when the robot turned left (anticlockwise). [Taylor06] eq. 13.
    """
    s = sin_of_tilt(tilt_rad)
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
