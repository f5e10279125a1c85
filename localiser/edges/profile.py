"""What an edge looks like: grey values across it, and which side is lighter."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges.undistort import Image, ideal_camera
from localiser.geometry import Array

PROFILE_OFFSETS_PX = np.array([-6.0, -4.5, -3.0, -1.5, 0.0, 1.5, 3.0, 4.5, 6.0])
_SAMPLES_ALONG = 16


def profiles(ends_px: Array, image: Image, camera: Camera, taken_of: Callable[[Array], Array] | None = None) -> Array:
    """Return grey values (S, P) across segments (S, 2, 2), given in undistorted pixels, from left to right.

    Means along each segment at `PROFILE_OFFSETS_PX`; nan where all of that lies outside the image. taken_of: where
    points of the segments (S, A, P, 2) were taken, if a rolling shutter took them elsewhere.
    """
    if len(ends_px) == 0:
        return np.zeros((0, len(PROFILE_OFFSETS_PX)))
    bottom, top = ends_px[:, None, None, 0], ends_px[:, None, None, 1]
    along = ((np.arange(_SAMPLES_ALONG) + 0.5) / _SAMPLES_ALONG)[:, None, None]
    up = (top - bottom) / np.maximum(np.linalg.norm(top - bottom, axis=-1, keepdims=True), 1e-9)
    rightwards = up[..., ::-1] * [-1.0, 1.0]
    points = bottom + (top - bottom) * along + rightwards * PROFILE_OFFSETS_PX[:, None]
    points = points if taken_of is None else taken_of(points)
    bent = camera.is_distorted
    taken = camera.pixels_from_image(ideal_camera(camera).image_from_pixels(points)) if bent else points
    u, v = np.ascontiguousarray(taken.astype(np.float32).reshape(len(ends_px), -1, 2).transpose(2, 0, 1))
    inside = ((u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)).reshape(taken.shape[:-1])
    grey = cv2.remap(image, u, v, cv2.INTER_LINEAR).reshape(inside.shape)
    seen = inside.sum(axis=1)
    return np.where(seen > 0, (grey * inside).sum(axis=1) / np.maximum(seen, 1), np.nan)


def polarity_of_profiles(profile: Array) -> NDArray[np.int8]:
    """Return (S,) +1 where the right side of a profile (S, P) is lighter than the left, -1 where darker, else 0."""
    middle = len(PROFILE_OFFSETS_PX) // 2
    step = profile[:, middle + 1] - profile[:, middle - 1]
    return np.sign(np.nan_to_num(step)).astype(np.int8)
