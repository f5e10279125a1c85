"""Which segments are vertical edges, and which of those are one edge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges.segments import Segments
from localiser.geometry import Array

_ABOVE_NADIR = 0.05
"""Least c + e s of an edge's ends: closer to the nadir point, or below it, a line tells no bearing ahead."""


def nadir_miss_sigma_px(segments: Segments, camera: Camera, mount_sigma_rad: Array) -> Array:
    """Return the sigma (S,) of `Camera.nadir_miss_px` of segments (S).

    Both ends err by σ, so half their difference errs by σ/√2. An error of the mount (tilt, roll) (2,) turns the
    direction towards the nadir point, seen from (a, e), by a / q² and c (c + e s) / q², q² = (a s)² + (c + e s)².
    """
    ends = camera.undistorted().upright_from_pixels(segments.ends_px)
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    a, e = np.moveaxis(ends.mean(axis=1), -1, 0)
    depth = c + e * s
    per_mount = np.stack([a, c * depth], axis=-1) / ((a * s) ** 2 + depth**2)[:, None]
    half_px = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1) / 2 * camera.focal_px
    return np.asarray(np.sqrt(segments.sigma_px**2 / 2 + half_px**2 * (per_mount**2 @ mount_sigma_rad**2)))


def is_vertical(segments: Segments, camera: Camera, mount_sigma_rad: Array, gate_sigma: float) -> NDArray[np.bool_]:
    """Return (S,) whether segments meet the nadir point within what their noise and the mount's error allow.

    A segment so short that it would pass in any direction proves nothing, and is left out.
    """
    ideal = camera.undistorted()
    miss = ideal.nadir_miss_px(segments.ends_px)
    e = ideal.upright_from_pixels(segments.ends_px)[..., 1]
    above_nadir = (np.cos(camera.mount.tilt_rad) + e * np.sin(camera.mount.tilt_rad) > _ABOVE_NADIR).all(axis=1)
    allowed = gate_sigma * nadir_miss_sigma_px(segments, camera, mount_sigma_rad)
    half_px = np.linalg.norm(segments.ends_px[:, 1] - segments.ends_px[:, 0], axis=-1) / 2
    return np.asarray(above_nadir & (np.abs(miss) <= allowed) & (half_px > 2 * allowed))


def same_edge(
    segments: Segments,
    polarity: NDArray[np.int8],
    camera: Camera,
    mount_sigma_rad: Array,
    gate_sigma: float,
) -> NDArray[np.int64]:
    """Return the edge (S,) that each vertical segment belongs to, numbered from 0; -1 never occurs.

    Segments are one edge when they look the same way (polarity) and their bearings agree within noise, however long
    the gap between them: what stands in front of an edge hides it. The most certain segment gathers first, so that
    uncertain ones cannot chain two edges together.
    """
    ideal = camera.undistorted()
    bearing = ideal.bearing_of_segments(segments.ends_px)
    variance = ideal.bearing_sigma_of_segments(segments.ends_px, segments.sigma_px) ** 2
    per_mount = ideal.bearing_jacobians(bearing, ideal.upright_from_pixels(segments.ends_px)[..., 1].mean(axis=1))[1]
    edge = np.full(len(segments), -1, dtype=np.int64)
    count = 0
    for first in np.argsort(variance, kind="stable"):
        if edge[first] >= 0:
            continue
        by_mount = (per_mount - per_mount[first]) ** 2 @ mount_sigma_rad**2
        near = (bearing - bearing[first]) ** 2 <= gate_sigma**2 * (variance + variance[first] + by_mount)
        edge[near & (polarity == polarity[first]) & (edge < 0)] = count
        count += 1
    return edge
