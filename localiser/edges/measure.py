"""Measure vertical edges: lean, bearing and their sigmas, foot, and what they look like."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.edges.segments import Segments
from localiser.edges.types import CommonError, Edges
from localiser.edges.undistort import Image
from localiser.geometry import Array

PROFILE_OFFSETS_PX = np.array([-6.0, -4.5, -3.0, -1.5, 0.0, 1.5, 3.0, 4.5, 6.0])
_SAMPLES_ALONG = 24
_BORDER_PX = 3.0
"""An edge that ends this close to the image border goes on outside."""
FOOT_SIGMA_PX = 2.0
"""Error of an edge's lower end along the edge: where a line stops is far less certain than where it runs."""


def profiles(ends_px: Array, image: Image, camera: Camera) -> Array:
    """Return grey values (S, P) across segments (S, 2, 2), given in undistorted pixels, from left to right.

    Medians along each segment at `PROFILE_OFFSETS_PX`; nan where the segment's surroundings leave the image.
    """
    if len(ends_px) == 0:
        return np.zeros((0, len(PROFILE_OFFSETS_PX)))
    bottom, top = ends_px[:, None, None, 0], ends_px[:, None, None, 1]
    along = (np.arange(_SAMPLES_ALONG) + 0.5)[None, :, None, None] / _SAMPLES_ALONG
    up = (top - bottom) / np.maximum(np.linalg.norm(top - bottom, axis=-1, keepdims=True), 1e-9)
    rightwards = up[..., ::-1] * [-1.0, 1.0]
    points = bottom + (top - bottom) * along + rightwards * PROFILE_OFFSETS_PX[None, None, :, None]
    taken = camera.pixels_from_image(camera.undistorted().image_from_pixels(points)).astype(np.float32)
    grey = _sampled(image, taken.reshape(len(ends_px), -1, 2)).reshape(points.shape[:-1])
    inside = np.all((taken >= 0) & (taken <= [camera.width - 1, camera.height - 1]), axis=-1)
    grey[~inside] = np.nan
    seen = np.any(inside, axis=1)
    return np.where(seen, np.nanmedian(np.where(seen[:, None], grey, 0.0), axis=1), np.nan)


def _sampled(image: Image, points_px: NDArray[np.float32]) -> Array:
    """Return grey values (S, K) at pixels (S, K, 2), bilinear."""
    columns, rows = points_px[..., 0], points_px[..., 1]
    sampled = cv2.remap(image.astype(np.float32), columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, dtype=np.float64)


def polarity_of_profiles(profile: Array) -> NDArray[np.int8]:
    """Return (S,) +1 where the right side of a profile (S, P) is lighter than the left, -1 where darker, else 0."""
    middle = len(PROFILE_OFFSETS_PX) // 2
    step = profile[:, middle + 1] - profile[:, middle - 1]
    return np.sign(np.nan_to_num(step)).astype(np.int8)


@dataclass(frozen=True, slots=True, eq=False)
class _Gathered:
    """Sums over the segment ends that belong to each of E edges."""

    edge: NDArray[np.int64]
    count: int

    def sum(self, per_end: Array) -> Array:
        """Return (E,) sums of a quantity (S, 2) of segment ends."""
        return np.asarray(np.bincount(self.edge, per_end.sum(axis=1), self.count), dtype=np.float64)

    def lowest(self, per_end: Array) -> Array:
        """Return (E,) minima of a quantity (S, 2) of segment ends."""
        lowest = np.full(self.count, np.inf)
        np.minimum.at(lowest, self.edge, per_end.min(axis=1))
        return lowest


def edges_of_segments(
    segments: Segments, edge: NDArray[np.int64], image: Image, camera: Camera, mount_sigma_rad: Array
) -> Edges:
    """Return the edges (E) that segments (S) make up, where `edge` (S,) says which segment belongs to which.

    Bearing and lean are least squares over the ends of an edge's segments, weighed by their sigmas: design
    equation 7 for any number of ends. The bearing's line is held through the nadir point, the lean's is free.
    """
    count = int(edge.max()) + 1 if len(edge) else 0
    if count == 0:
        return Edges.none()
    gather = _Gathered(edge, count)
    ends = camera.undistorted().upright_from_pixels(segments.ends_px)
    a, e = ends[..., 0], ends[..., 1]
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    depth = c + e * s
    # Errors across a leaning line are larger by 1 / cos(lean) along a.
    segment_lean = camera.undistorted().lean_of_segments(segments.ends_px)
    weight = ((np.cos(segment_lean) / segments.sigma_px * camera.focal_px) ** 2)[:, None] * np.ones(2)

    depth_sum = gather.sum(weight * depth**2)
    tangent = gather.sum(weight * a * depth) / depth_sum
    bearing = np.arctan(tangent)
    bearing_sigma = np.cos(bearing) ** 2 / np.sqrt(depth_sum)

    total = gather.sum(weight)
    mean_a, mean_e = gather.sum(weight * a) / total, gather.sum(weight * e) / total
    spread = gather.sum(weight * (e - mean_e[edge, None]) ** 2)
    run = gather.sum(weight * (e - mean_e[edge, None]) * a) / spread
    lean = np.arctan(run)
    lean_sigma = np.cos(lean) ** 2 / np.sqrt(spread)

    low, high = gather.lowest(e), -gather.lowest(-e)
    upright = np.stack(
        [np.stack([mean_a + run * (at - mean_e), at], axis=-1) for at in (low, high)],
        axis=1,
    )
    image_ends = camera.image_from_upright(upright)
    ends_px = camera.pixels_from_image(image_ends)
    profile = profiles(camera.undistorted().pixels_from_image(image_ends), image, camera)
    lengths = np.linalg.norm(segments.ends_px[:, 1] - segments.ends_px[:, 0], axis=-1)
    foot_range, foot_sigma = foot_of_edges(ends_px[:, 0], camera)
    return Edges.from_columns(
        bearing,
        bearing_sigma,
        lean,
        lean_sigma,
        length_px=np.minimum(np.bincount(edge, lengths, count), np.linalg.norm(ends_px[:, 1] - ends_px[:, 0], axis=-1)),
        polarity=polarity_of_profiles(profile),
        ends_px=ends_px,
        foot_range_m=foot_range,
        foot_range_sigma_m=foot_sigma,
        profile=profile,
        common=common_error(bearing, mean_e, camera, mount_sigma_rad),
    )


def foot_of_edges(bottom_px: Array, camera: Camera) -> tuple[Array, Array]:
    """Return the floor range (E,) m of feet seen at pixels (E, 2), and its sigma; nan where no foot is seen.

    A foot is where an edge ends inside the image and below the horizon; whether it is the floor that it ends at, a
    single image cannot tell. Design equation 9.
    """
    inside = (bottom_px >= _BORDER_PX) & (bottom_px <= [camera.width - 1 - _BORDER_PX, camera.height - 1 - _BORDER_PX])
    rays = camera.level_rays(bottom_px)
    depression = np.arctan2(-rays[:, 1], np.hypot(rays[:, 0], rays[:, 2]))
    seen = inside.all(axis=1) & (depression > FOOT_SIGMA_PX / camera.focal_px)
    range_m = geometry.floor_range(camera.mount.height_m, np.where(seen, depression, np.nan))
    sigma_rad = FOOT_SIGMA_PX / camera.focal_px
    return range_m, geometry.floor_range_sigma(camera.mount.height_m, range_m, sigma_rad)


def common_error(bearing: Array, middle_e: Array, camera: Camera, mount_sigma_rad: Array) -> CommonError:
    """Return what an error of tilt and roll (2,) does to the bearings (E,) of a frame (design equation 8)."""
    from_lean, from_line = camera.bearing_jacobians(bearing, middle_e)
    return CommonError(("tilt", "roll"), np.diag(mount_sigma_rad**2), from_lean, from_line)
