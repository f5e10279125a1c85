"""Which landmarks an image truly shows, and between which pixels: to choose a map's landmarks, to judge detectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.geometry import Array
from localiser.landmarks import in_camera
from localiser.simulate.raycast import NEAR_M, cast
from localiser.simulate.structure import Structure

Mask = NDArray[np.bool_]

_SAMPLES = 128  # along each edge's part in the image
_BESIDE_M = 0.0005  # an edge is looked at just left and just right of it
_BEHIND_M = 0.015  # what is hit no further before the edge than this is the edge's own surface


@dataclass(frozen=True, slots=True, eq=False)
class Visible:
    """Landmarks that an image shows, V of them.

    landmark: (V,) index in the structure's map. ends_px: (V, 2, 2) lowest and highest visible sample (u, v). fraction:
    (V,) visible part of the landmark's height. Contrast is not considered.
    """

    landmark: NDArray[np.int64]
    ends_px: Array
    fraction: Array

    def __len__(self) -> int:
        return len(self.landmark)


def visible_landmarks(structure: Structure, camera: Camera, robot_pose: Array) -> Visible:
    """Return the landmarks inside the camera's image that no solid hides, seen from a robot at (3,) in the map.

    An edge is seen at a height when the line of sight just left or just right of it reaches it.
    """
    camera_pose = camera.pose_in_map(robot_pose)
    right, ahead = (axis[0] for axis in in_camera(camera_pose[None], structure.edges.points))
    low, high = _bearing_limits(camera)
    candidate = (structure.landmark >= 0) & (ahead > NEAR_M)
    candidate &= (right >= low * ahead) & (right <= high * ahead)
    edge = np.flatnonzero(candidate)
    tangent, ahead = right[edge] / ahead[edge], ahead[edge]
    bottom, top = structure.edges.bottom_m[edge], structure.edges.top_m[edge]
    points = _samples(camera, tangent, ahead, bottom, top)
    pixels = camera.project_level(points)
    size = np.array([camera.width, camera.height])
    inside = ((pixels >= -0.5) & (pixels <= size - 0.5)).all(axis=-1)
    offset = _BESIDE_M * np.hypot(1.0, tangent) / ahead
    left, right = (_is_reached(structure, camera, camera_pose, tangent + side * offset, points) for side in (-1, 1))
    return _by_landmark(structure.landmark[edge], points, pixels, inside & (left | right), top - bottom)


def _border_rays(camera: Camera) -> Array:
    """Return rays of the level frame (R, 3) through the rim of the image, scaled to one metre ahead."""
    rays = camera.level_rays(camera.border_px(33, 0.5).reshape(-1, 2))
    return rays / np.maximum(-rays[:, 2:], 1e-3)


def _bearing_limits(camera: Camera) -> tuple[float, float]:
    across = _border_rays(camera)[:, 0]
    return float(across.min()), float(across.max())


def _samples(camera: Camera, tangent: Array, ahead: Array, bottom: Array, top: Array) -> Array:
    """Return points (M, S, 3) of the level frame along edges, within the heights that the image can show at all."""
    elevation = _border_rays(camera)[:, 1]
    low, high = elevation.min() * ahead, elevation.max() * ahead
    first = np.clip(bottom - camera.mount.height_m, low, high)
    last = np.clip(top - camera.mount.height_m, low, high)
    height = first[:, None] + (last - first)[:, None] * np.linspace(0, 1, _SAMPLES)
    return np.stack(np.broadcast_arrays((tangent * ahead)[:, None], height, -ahead[:, None]), axis=-1)


def _is_reached(structure: Structure, camera: Camera, camera_pose: Array, beside: Array, points: Array) -> Mask:
    """Return where (M, S) lines of sight in the directions `beside` (M,), tan(bearing), get as far as the edges.

    points: (M, S, 3) samples of the edges in the level frame.
    """
    ahead = -points[:, 0, 2]
    elevation = points[..., 1] / ahead[:, None]
    hits = cast(structure.solids, camera_pose, beside)
    before = hits.entry < ahead - _BEHIND_M / np.hypot(1.0, beside)
    in_front = np.flatnonzero(before.any(axis=1))
    entry, leave = hits.entry[in_front], np.minimum(hits.leave[in_front], ahead)
    # A solid hides the elevations between the lowest and the highest of its four ends: bottom and top, near and far.
    eye = camera.mount.height_m
    bottom, top = (height[in_front, None] - eye for height in (structure.solids.bottom_m, structure.solids.top_m))
    low = np.where(before[in_front], np.minimum(bottom / entry, bottom / leave), np.inf)
    high = np.where(before[in_front], np.maximum(top / entry, top / leave), -np.inf)
    hidden = (elevation >= low[..., None]) & (elevation <= high[..., None])
    return np.asarray(~hidden.any(axis=0))


def _by_landmark(landmark: NDArray[np.int64], points: Array, pixels: Array, shown: Mask, length_m: Array) -> Visible:
    """Return what is shown of each landmark: its edges' samples (M, S) together."""
    # One sample alone is the end of an edge that something hides.
    shown = shown & (shown.sum(axis=1, keepdims=True) > 1)
    step = np.ptp(points[..., 1], axis=1) / (points.shape[1] - 1)
    fraction = np.minimum(shown.sum(axis=1) * step / length_m, 1.0)
    ids, ends, fractions = [], [], []
    for index in np.unique(landmark[shown.any(axis=1)]):
        own = landmark == index
        seen, height = pixels[own][shown[own]], points[own][shown[own], 1]
        ids.append(index)
        ends.append([seen[height.argmin()], seen[height.argmax()]])
        fractions.append(fraction[own].max())
    return Visible(np.array(ids, dtype=np.int64), np.array(ends).reshape(-1, 2, 2), np.array(fractions))
