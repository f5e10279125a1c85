"""The paper: bearing, slope and lean of a vertical edge under a tilted camera.

[Taylor06] is Taylor, Geva, Boles, "Using Camera Tilt to Assist with Localisation", ICARA 2006.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from localiser.geometry.poses import Array, wrap_half_turn


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
