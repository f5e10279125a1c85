"""How a landmark is seen from a pose: its bearing, its range, where its ends are in the image, and as a line to draw.

Tests compare compiled loops, which repeat a part of it for speed, with these plain functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from localiser.camera import Camera
from localiser.geometry import Array, Indices, robot_from_map
from localiser.landmarks.landmark_map import LandmarkMap


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """Landmarks that cameras can see: P pairs (camera pose, landmark), sorted by pose.

    pose, landmark: (P,) indices. tangent: (P,) tan(bearing). range_m: (P,) floor distance.
    """

    pose: Indices
    landmark: Indices
    tangent: Array
    range_m: Array


@dataclass(frozen=True, slots=True)
class SightParameters:
    """Which landmarks count as visible."""

    range_max_m: Annotated[float, Field(gt=0, description="walls hide most landmarks that are farther away (m)")] = 12.0
    range_far_m: Annotated[float, Field(gt=0, description="landmarks farther away are not expected at all (m)")] = 25.0
    range_min_m: Annotated[float, Field(ge=0, description="landmarks nearer than this are not expected (m)")] = 0.2
    length_min_px: Annotated[float, Field(ge=0, description="shortest visible part that is expected (px)")] = 15.0
    margin_px: Annotated[float, Field(ge=0, description="how far outside the image an edge still counts (px)")] = 5.0

    @property
    def farthest_m(self) -> float:
        """How far away landmarks may be seen, down a long corridor too."""
        return max(self.range_max_m, self.range_far_m)


def sight(
    camera: Camera, camera_poses: Array, landmark_map: LandmarkMap, parameters: SightParameters | None = None
) -> Sight:
    """Return which landmarks (L) the camera sees from each of its floor poses (N, 3) in the map.

    A landmark is seen where its vertical edge, from bottom to top (the whole vertical line where these are unknown),
    crosses the image within the range limits. Walls do not hide anything: the map holds edges, not surfaces.
    """
    parameters = parameters or SightParameters()
    points = landmark_map.points
    # Those that can be within range of some pose are near the box of all poses.
    low, high = camera_poses[:, :2].min(axis=0), camera_poses[:, :2].max(axis=0)
    (x, z), reach_m = points.T, parameters.range_max_m
    is_near = (x >= low[0] - reach_m) & (x <= high[0] + reach_m) & (z >= low[1] - reach_m) & (z <= high[1] + reach_m)
    near = np.flatnonzero(is_near)
    right, ahead = in_camera(camera_poses, points[near])
    range_squared = right**2 + ahead**2
    in_range = (range_squared <= parameters.range_max_m**2) & (range_squared >= parameters.range_min_m**2)
    possible = (ahead > 0) & in_range & (np.abs(right) <= ahead * widest_tangent(camera, parameters))
    pose, column = np.nonzero(possible)
    right, ahead, landmark = right[pose, column], ahead[pose, column], near[column]
    tangent = right / ahead
    e_ends = image_heights(camera, ahead, landmark_map.bottom_m[landmark], landmark_map.top_m[landmark])
    length_px = visible_length_px(camera, tangent, *e_ends, parameters.margin_px)
    seen, range_m = length_px >= max(parameters.length_min_px, 1e-9), np.sqrt(range_squared[pose, column])
    return Sight(pose[seen], landmark[seen], tangent[seen], range_m[seen])


def in_camera(camera_poses: Array, points: Array) -> tuple[Array, Array]:
    """Return (right, ahead), each (N, L) m: points (L, 2) of the map in the level frames of camera poses (N, 3)."""
    seen = robot_from_map(camera_poses[:, None], points)
    return seen[..., 0], -seen[..., 1]


def visible_length_px(camera: Camera, tangent: Array, e_bottom: Array, e_top: Array, margin_px: float = 0.0) -> Array:
    """Return the length (P,) in pixels of the part of vertical edges that lies inside the image, 0 where none does.

    tangent: (P,) tan(bearing). e_bottom, e_top: (P,) upright image heights of the ends, see `image_heights`. They are
    cut to the rectangle of the image, widened by `margin_px`. An edge is the line a = tan b (c + e s).
    """
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    margin = margin_px / camera.focal_px
    a_left, a_right, e_low, e_high = np.array(camera.upright_bounds) + margin * np.array([-1.0, 1.0, -1.0, 1.0])
    start, end = np.maximum(e_bottom, e_low), np.minimum(e_top, e_high)
    # Left and right border: (c + e s) <= limit, which bounds e from above (tilt down) or from below (tilt up).
    with np.errstate(divide="ignore"):
        limit = np.where(tangent > 0, a_right, a_left) / np.where(tangent == 0, np.copysign(0.0, a_left), tangent)
    if s > 1e-12:
        end = np.minimum(end, (limit - c) / s)
    elif s < -1e-12:
        start = np.maximum(start, (limit - c) / s)
    else:
        end = np.where(c <= limit, end, -np.inf)
    return np.asarray(np.maximum(end - start, 0.0) * np.sqrt(1.0 + (s * tangent) ** 2) * camera.focal_px)


def image_heights(camera: Camera, ahead_m: Array, bottom_m: Array, top_m: Array) -> tuple[Array, Array]:
    """Return the upright image heights e, each (P,), of the bottoms and tops of vertical edges.

    ahead_m: (P,) distance along the camera's level axis, > 0. bottom_m, top_m: (P,) above the floor; where unknown
    (nan) the edge goes on for ever. An end beyond the image plane is infinitely high or low.
    """
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    above_camera_m = np.stack([bottom_m, top_m]) - camera.mount.height_m
    depth = ahead_m * c - above_camera_m * s
    with np.errstate(divide="ignore", invalid="ignore"):
        e = (above_camera_m * c + ahead_m * s) / depth
    e = np.where(depth > 0, e, np.copysign(np.inf, above_camera_m))
    bottom, top = np.isnan(above_camera_m)
    return np.where(bottom, -np.inf, e[0]), np.where(top, np.inf, e[1])


@lru_cache(maxsize=16)
def widest_tangent(camera: Camera, parameters: SightParameters) -> float:
    """Return a bound on |tan(bearing)| inside the image: at its narrow end, where c + e s is smallest."""
    a_left, a_right, e_low, e_high = camera.upright_bounds
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    margin = parameters.margin_px / camera.focal_px
    nearest = min(c + (e_low - margin) * s, c + (e_high + margin) * s)
    return (max(-a_left, a_right) + margin) / nearest if nearest > 1e-6 else np.inf


@lru_cache(maxsize=16)
def field_of_view_rad(camera: Camera) -> float:
    """Return the angle between the bearings of the image's left and right border, on the principal point's row."""
    a_left, a_right, _, _ = camera.upright_bounds
    left, right = np.arctan(np.array([a_left, a_right]) / np.cos(camera.mount.tilt_rad))
    return float(right - left)


@lru_cache(maxsize=16)
def half_view_rad(camera: Camera) -> float:
    """Return the largest angle to either side that the image sees, at whichever height it sees widest."""
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    a_left, a_right, e_low, e_high = camera.upright_bounds
    narrowest = max(min(c + e_low * s, c + e_high * s), 0.25 * c)
    return float(np.arctan(max(-a_left, a_right) / narrowest))


_FINE_STEPS = 129  # points at which a landmark's line is asked whether it is inside the image: a few pixels apart


def landmark_ends(landmark_map: LandmarkMap, camera: Camera) -> Array:
    """Return bottom and top (L, 2, 3) of each landmark in the map; of unknown ones the floor, and twice its height."""
    bottom = np.where(np.isnan(landmark_map.bottom_m), 0.0, landmark_map.bottom_m)
    top = np.where(np.isnan(landmark_map.top_m), bottom + 2 * camera.mount.height_m, landmark_map.top_m)
    x, z = landmark_map.points.T
    return np.stack([np.stack([x, bottom, z], axis=-1), np.stack([x, top, z], axis=-1)], axis=1)


def predicted_lines(camera: Camera, pose: Array, ends: Array, visible: NDArray[np.bool_]) -> tuple[Indices, Array]:
    """Return indices (V,) of the landmarks that reach into the image from `pose`, and their image lines (V, S, 2).

    ends: (L, 2, 3) bottom and top in the map. visible: (L,) which to consider. Lines run upwards, bent by the lens:
    S is 2 for an ideal lens.
    """
    index = np.flatnonzero(visible)
    bottom, top = ends[index, 0], ends[index, 1]
    ahead = -robot_from_map(camera.pose_in_map(pose), bottom[:, [0, 2]])[:, 1]
    # Heights above the floor at the image's lower and upper border: the inverse of e = (c y + s d) / (c d - s y), with
    # y above the camera and d ahead. Cutting there keeps the lens polynomial where it was calibrated.
    s, c, height_m = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad), camera.mount.height_m
    # An image that reaches below the nadir point, or above the zenith, has no such height on that side.
    lowest, highest = (
        ahead * (e * c - s) / (c + e * s) + height_m if c + e * s > 1e-6 else np.full(len(ahead), e * np.inf)
        for e in camera.upright_bounds[2:]
    )
    low, high = np.maximum(bottom[:, 1], lowest), np.minimum(top[:, 1], highest)
    seen = (ahead > 0) & (high > low)
    points = np.repeat(bottom[seen][:, None, :], _FINE_STEPS, axis=1)
    points[:, :, 1] = np.linspace(low[seen], high[seen], _FINE_STEPS, axis=-1)
    fine = camera.project(pose, points)
    within = np.all((fine >= -0.5) & (fine <= np.array([camera.width, camera.height]) - 0.5), axis=-1)
    first, last = within.argmax(axis=1), _FINE_STEPS - 1 - within[:, ::-1].argmax(axis=1)
    # What leaves the image sideways is cut at the last point inside.
    shown = within.any(axis=1) & (last > first)
    step = np.linspace(first[shown], last[shown], 12 if camera.is_distorted else 2, axis=-1).round().astype(np.int64)
    return index[seen][shown], np.take_along_axis(fine[shown], step[..., None], axis=1)
