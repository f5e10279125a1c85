"""Resection: poses in closed form, from three bearings of known landmarks or from two with the ratio of ranges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.geometry import Array


def from_three_bearings(points: Array, bearings: Array) -> Array:
    """Return the camera's poses (K, 3) that see three landmarks at three bearings; nan where there is none.

    points: (K, 3, 2) landmarks in the map. bearings: (K, 3) rad, from the camera's forward axis, positive right.

    A landmark p lies on its ray when n·(Rᵀp - u) = 0 with n = (cos b, sin b) across the ray, R the camera's rotation by
    its heading h and u = Rᵀt. That is linear in (cos h, sin h, u): three rays leave one line of solutions, and
    cos² h + sin² h = 1 picks two points of it. They are mirrored through the camera, and at most one of them has all
    landmarks ahead. There is none where camera and landmarks lie on one circle.
    """
    nx, nz = np.cos(bearings), np.sin(bearings)
    px, pz = points[..., 0], points[..., 1]
    rows = np.stack([nx * px + nz * pz, nz * px - nx * pz, -nx, -nz], axis=-1)
    # Landmarks near the map's origin or far from it alike: scale the first two unknowns to the others.
    scale = np.maximum(np.abs(points).max(axis=(1, 2)), 1.0)
    rows[..., :2] /= scale[:, None, None]
    free, volume = _null_vector(rows)
    free[:, :2] /= scale[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        free /= np.hypot(free[:, 0], free[:, 1])[:, None]

    def pose_of(solution: Array) -> Array:
        cos, sin, ux, uz = solution.T
        return np.stack([cos * ux + sin * uz, -sin * ux + cos * uz, np.arctan2(sin, cos)], axis=-1)

    def is_ahead(poses: Array) -> NDArray[np.bool_]:
        seen = geometry.robot_from_map(poses[:, None], points)
        return np.asarray((seen[..., 0] * np.sin(bearings) > seen[..., 1] * np.cos(bearings)).all(axis=1))

    one, other = pose_of(free), pose_of(-free)
    found = np.where(is_ahead(one)[:, None], one, np.where(is_ahead(other)[:, None], other, np.nan))
    solvable = volume > 1e-6  # three rays that leave one line of solutions, and no more
    return np.where((solvable & np.isfinite(found).all(axis=1))[:, None], found, np.nan)


def _null_vector(rows: Array) -> tuple[Array, Array]:
    """Return the vector (K, 4) of length 1 across three rows (K, 3, 4), and the volume (K,) that the rows span.

    Its entries are the rows' 3×3 minors; their root of squares is the volume (Cauchy, Binet).
    """
    minors = [np.linalg.det(np.delete(rows, column, axis=-1)) * (-1) ** column for column in range(4)]
    vector = np.stack(minors, axis=-1)
    volume = np.linalg.norm(vector, axis=-1)
    return vector / np.maximum(volume, 1e-300)[:, None], volume


def from_two_bearings(first: Array, second: Array, bearings: Array, ranges: Array) -> Array:
    """Return the camera's poses (K, 3) that see landmarks `first` and `second` (K, 2) at two bearings (K, 2) exactly.

    ranges: (K, 2) distances, of which only the ratio counts: two bearings leave an arc through both landmarks (the
    angle between them is inscribed in it), and the ratio says where on it the camera is. The distance of the landmarks
    gives the scale, by the law of cosines.
    """
    ray = np.stack([np.sin(bearings), -np.cos(bearings)], axis=-1) * ranges[..., None]
    across, along = ray[:, 1] - ray[:, 0], second - first
    scale = np.hypot(along[:, 0], along[:, 1]) / np.hypot(across[:, 0], across[:, 1])
    # The rotation by h turns a vector's angle atan2(z, x) by -h.
    heading = np.arctan2(across[:, 1], across[:, 0]) - np.arctan2(along[:, 1], along[:, 0])
    turned = np.concatenate([np.zeros_like(first), heading[:, None]], axis=1)
    position = first - geometry.map_from_robot(turned, ray[:, 0] * scale[:, None])
    return np.concatenate([position, geometry.wrap_angle(heading)[:, None]], axis=1)
