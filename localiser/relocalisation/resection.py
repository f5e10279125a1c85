"""Poses in closed form: from three bearings of known landmarks, and from two with the ratio of their ranges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.geometry import Array


def from_three_bearings(points: Array, origins: Array, bearings: Array) -> Array:
    """Return the poses (2, K, 3) from which three landmarks are seen at three bearings; nan where there is none.

    points: (K, 3, 2) landmarks in the map. origins: (K, 3, 2) from where in the robot's frame each was seen; they may
    differ where the robot moved between the sightings. bearings: (K, 3) rad, from the robot's forward axis, positive
    right.

    A landmark p lies on its ray when n·(Rᵀp - u - o) = 0 with n = (cos b, sin b) across the ray, R the robot's rotation
    by its heading h and u = Rᵀt. That is linear in (cos h, sin h, u): three rays leave one line of solutions, and
    cos² h + sin² h = 1 picks two points of it. With one origin for all, the second is the first mirrored through it,
    landmarks behind the camera: nan. So is every pose when camera and landmarks lie on one circle.
    """
    nx, nz = np.cos(bearings), np.sin(bearings)
    px, pz = points[..., 0], points[..., 1]
    rows = np.stack([nx * px + nz * pz, nz * px - nx * pz, -nx, -nz], axis=-1)
    offset = nx * origins[..., 0] + nz * origins[..., 1]
    # Landmarks near the map's origin or far from it alike: scale the first two unknowns to the others.
    scale = np.maximum(np.abs(points).max(axis=(1, 2)), 1.0)
    rows[..., :2] /= scale[:, None, None]
    free, volume = _null_vector(rows)
    solvable = volume > 1e-6  # three rays that leave one line of solutions, and no more
    fixed = _shortest(rows, offset, solvable)
    fixed[:, :2] /= scale[:, None]
    free[:, :2] /= scale[:, None]
    return np.stack([_pose_on_line(fixed, free, step, solvable, points, origins, bearings) for step in (1.0, -1.0)])


def _pose_on_line(
    fixed: Array, free: Array, sign: float, solvable: NDArray[np.bool_], points: Array, origins: Array, bearings: Array
) -> Array:
    """Return the poses (K, 3) where the line fixed + λ free (K, 4) meets cos² h + sin² h = 1, nan if behind a ray."""
    square = (free[:, :2] ** 2).sum(axis=1)
    half = (free[:, :2] * fixed[:, :2]).sum(axis=1)
    rest = (fixed[:, :2] ** 2).sum(axis=1) - 1.0
    with np.errstate(invalid="ignore", divide="ignore"):
        step = (-half + sign * np.sqrt(half**2 - square * rest)) / square
        cos, sin, ux, uz = (fixed + step[:, None] * free).T
        poses = np.stack([cos * ux + sin * uz, -sin * ux + cos * uz, np.arctan2(sin, cos)], axis=-1)
        seen = geometry.robot_from_map(poses[:, None], points) - origins
        ahead = seen[..., 0] * np.sin(bearings) - seen[..., 1] * np.cos(bearings)
        valid = solvable & np.isfinite(poses).all(axis=1) & (ahead > 0).all(axis=1)
    return np.where(valid[:, None], poses, np.nan)


def _null_vector(rows: Array) -> tuple[Array, Array]:
    """Return the vector (K, 4) of length 1 across three rows (K, 3, 4), and the volume (K,) that the rows span.

    Its entries are the rows' 3×3 minors; their root of squares is the volume (Cauchy, Binet).
    """

    def minor(i: int, j: int, k: int) -> Array:
        a, b, c = rows[:, 0], rows[:, 1], rows[:, 2]
        return np.asarray(
            a[:, i] * (b[:, j] * c[:, k] - b[:, k] * c[:, j])
            - a[:, j] * (b[:, i] * c[:, k] - b[:, k] * c[:, i])
            + a[:, k] * (b[:, i] * c[:, j] - b[:, j] * c[:, i])
        )

    vector = np.stack([minor(1, 2, 3), -minor(0, 2, 3), minor(0, 1, 3), -minor(0, 1, 2)], axis=-1)
    volume = np.linalg.norm(vector, axis=-1)
    return vector / np.maximum(volume, 1e-300)[:, None], volume


def _shortest(rows: Array, offset: Array, solvable: NDArray[np.bool_]) -> Array:
    """Return the shortest vector (K, 4) with rows · vector = offset (K, 3): zero where all rays have one origin."""
    result = np.zeros((len(rows), 4))
    needed = np.flatnonzero(solvable & offset.any(axis=1))
    own = rows[needed]
    across = own.transpose(0, 2, 1)
    result[needed] = (across @ np.linalg.solve(own @ across, offset[needed][..., None]))[..., 0]
    return result


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
