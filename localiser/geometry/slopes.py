"""Bearing, slope and lean of a vertical edge under a tilted camera; what only the paper needs is in `paper.slopes`.

[Taylor06] is Taylor, Geva, Boles, "Using Camera Tilt to Assist with Localisation", ICARA 2006.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from localiser.geometry.poses import Array


def sin_of_tilt(tilt_rad: float) -> float:
    """Return the sine of a tilt. Raises ValueError when that is 0."""
    sine = float(np.sin(tilt_rad))
    if abs(sine) < 1e-12:
        raise ValueError("tilt is 0: every vertical edge is vertical in the image, its slope tells no direction")
    return sine


def bearing_from_point(x: ArrayLike, z: ArrayLike) -> Array:
    """Return the bearing (rad, positive right) of a point (x, z) of the camera's level frame; ±pi/2 beside it."""
    return np.asarray(np.arctan2(x, -np.asarray(z, dtype=np.float64)))


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


def edge_a_at(e: ArrayLike, bearing_rad: ArrayLike, tilt_rad: float) -> Array:
    """Return where the vertical edge at this bearing crosses the image height e: a = tan(b) (c + e s)."""
    e = np.asarray(e, dtype=np.float64)
    return np.asarray(np.tan(bearing_rad) * (np.cos(tilt_rad) + e * np.sin(tilt_rad)))


def bearing_per_lean(bearing_rad: ArrayLike, tilt_rad: float) -> Array:
    """Return J = d(bearing)/d(lean) = (cos²b + s² sin²b) / s. Raises ValueError when the tilt is 0."""
    s = sin_of_tilt(tilt_rad)
    return np.asarray((np.cos(bearing_rad) ** 2 + s**2 * np.sin(bearing_rad) ** 2) / s)
