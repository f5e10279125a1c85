"""Lines that the mount alone predicts: vertical edges of round bearings, which meet at the nadir point; the horizon."""

from __future__ import annotations

import numpy as np

from localiser import geometry
from localiser.camera import Camera
from localiser.geometry import Array

_STEPS = 129
_WIDEST_DEG = 80.0
_FEW_LINES = 9
_LEAST_DEPTH = 0.02


def bearings_shown(camera: Camera) -> Array:
    """Return round bearings in degrees across the view, so few that they stay apart."""
    a, e = _border(camera)
    depth = _depth(camera, e)
    tangent = (a / depth)[depth > _LEAST_DEPTH]
    low, high = np.rad2deg(np.arctan([tangent.min(), tangent.max()])).clip(-_WIDEST_DEG, _WIDEST_DEG)
    step = next((step for step in (1, 2, 5, 10) if high - low <= _FEW_LINES * step), 20)
    return np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step


def meridian(camera: Camera, bearing_rad: float) -> Array:
    """Return pixels (S, 2) along the image line of a vertical edge at this bearing, those inside the image."""
    _, border_e = _border(camera)
    e = np.linspace(border_e.min(), border_e.max(), _STEPS)
    e = e[_depth(camera, e) > _LEAST_DEPTH]
    return _inside(camera, np.stack([geometry.edge_a_at(e, bearing_rad, camera.mount.tilt_rad), e], axis=-1))


def horizon(camera: Camera) -> Array:
    """Return pixels (S, 2) of points infinitely far away at the camera's height, those inside the image."""
    reach = np.abs(camera.image_from_pixels(camera.border_px(33, 0.5))).max() * 1.5
    a = np.linspace(-reach, reach, 2 * _STEPS)
    return _inside(camera, np.stack([a, np.full_like(a, np.tan(camera.mount.tilt_rad))], axis=-1))


def _border(camera: Camera) -> Array:
    """Return upright coordinates a and e (2, P) of the image's border."""
    return camera.upright_from_pixels(camera.border_px(33, 0.5).reshape(-1, 2)).T


def _depth(camera: Camera, e: Array) -> Array:
    return np.asarray(np.cos(camera.mount.tilt_rad) + e * np.sin(camera.mount.tilt_rad))


def _inside(camera: Camera, upright: Array) -> Array:
    upright = upright[np.linalg.norm(upright, axis=-1) < camera.lens_radius]
    pixels = camera.pixels_from_upright(upright)
    size = np.array([camera.width, camera.height])
    return np.asarray(pixels[np.all((pixels > -1.5) & (pixels < size + 0.5), axis=-1)])
