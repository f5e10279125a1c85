"""Where landmarks are expected in an image, as lines to draw."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.geometry import Array
from localiser.landmarks.landmark_map import LandmarkMap

_FINE_STEPS = 129
"""Points at which a landmark's line is asked whether it is inside the image: a few pixels apart."""


def landmark_ends(landmark_map: LandmarkMap, camera: Camera) -> Array:
    """Return bottom and top (L, 2, 3) of each landmark in the map.

    A height that is not known has to be drawn somehow: from the floor to twice the camera's height, which the camera
    looks at.
    """
    bottom = np.where(np.isnan(landmark_map.bottom_m), 0.0, landmark_map.bottom_m)
    top = np.where(np.isnan(landmark_map.top_m), bottom + 2 * camera.mount.height_m, landmark_map.top_m)
    x, z = landmark_map.points.T
    return np.stack([np.stack([x, bottom, z], axis=-1), np.stack([x, top, z], axis=-1)], axis=1)


def predicted_lines(
    camera: Camera, pose: Array, ends: Array, visible: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], Array]:
    """Return indices (V,) of the landmarks that reach into the image from `pose`, and their image lines (V, S, 2).

    ends: (L, 2, 3) bottom and top in the map. visible: (L,) which to consider. Lines run upwards, bent by the lens:
    S is 2 for an ideal lens.
    """
    index = np.flatnonzero(visible)
    bottom, top = ends[index, 0], ends[index, 1]
    ahead = -geometry.robot_from_map(camera.pose_in_map(pose), bottom[:, [0, 2]])[:, 1]
    lowest, highest = _heights_in_image(camera, ahead)
    low, high = np.maximum(bottom[:, 1], lowest), np.minimum(top[:, 1], highest)
    seen = (ahead > 0) & (high > low)
    low, high = low[seen], high[seen]
    fine = _vertical_lines(camera, pose, bottom[seen], low, high, _FINE_STEPS)
    within = np.all((fine >= -0.5) & (fine <= np.array([camera.width, camera.height]) - 0.5), axis=-1)
    first, last = within.argmax(axis=1), _FINE_STEPS - 1 - within[:, ::-1].argmax(axis=1)
    # What leaves the image sideways is cut at the last point inside.
    shown, length = within.any(axis=1) & (last > first), (high - low) / (_FINE_STEPS - 1)
    low, high = low + first * length, low + last * length
    steps = 12 if camera.is_distorted else 2
    return index[seen][shown], _vertical_lines(camera, pose, bottom[seen][shown], low[shown], high[shown], steps)


def _vertical_lines(camera: Camera, pose: Array, feet: Array, low: Array, high: Array, steps: int) -> Array:
    """Return pixels (V, S, 2) of points over feet (V, 3) in the map, from the height `low` (V,) to `high` (V,)."""
    points = np.repeat(feet[:, None, :], steps, axis=1)
    points[:, :, 1] = np.linspace(low, high, steps, axis=-1)
    return camera.project(pose, points)


def _heights_in_image(camera: Camera, ahead: Array) -> tuple[Array, Array]:
    """Return the heights above the floor (L,) at the image's lower and upper border for points so far ahead.

    The inverse of e = (c y + s d) / (c d - s y), with y above the camera and d ahead of it. Clipping before the
    projection keeps the lens polynomial where it was calibrated.
    """
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    _, _, e_bottom, e_top = camera.upright_bounds
    low, high = (ahead * (e * c - s) / (c + e * s) + camera.mount.height_m for e in (e_bottom, e_top))
    return np.asarray(low), np.asarray(high)
