"""Edges as a camera would measure them, without images: truth plus Gaussian noise of known sigma, plus clutter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap, in_camera
from localiser.simulate import visible_landmarks
from localiser.simulate.structure import Structure

MOST_CUT = 0.4  # of an edge, at either end


@dataclass(frozen=True, slots=True)
class EdgeNoise:
    """How edges are measured.

    endpoint_sigma_px: error of each end of a segment, across it. along_sigma_px: the same along it. cut_probability:
    chance for each end that the segment stops short of it, by up to 0.4 of its length. detection_probability: chance
    that a visible edge is found. clutter_per_frame: mean number of false edges in an image (Poisson). range_min_m,
    range_max_m, length_min_px: what is nearer, farther or shorter is not found. turned_probability: chance that an edge
    shows the other polarity than its landmark has.
    """

    endpoint_sigma_px: float = 0.5
    along_sigma_px: float = 0.0
    cut_probability: float = 0.0
    detection_probability: float = 1.0
    clutter_per_frame: float = 0.0
    range_min_m: float = 0.2
    range_max_m: float = 12.0
    length_min_px: float = 20.0
    turned_probability: float = 0.0


class _Segments(NamedTuple):
    """True image segments, P of them, sorted by frame, in the upright image.

    frame, landmark: (P,) indices, landmark -1 for clutter. tangent: (P,) tan(bearing). e: (P, 2) bottom and top height.
    """

    frame: NDArray[np.int64]
    landmark: NDArray[np.int64]
    tangent: Array
    e: Array


def simulated_edges(
    landmark_map: LandmarkMap,
    camera: Camera,
    truth: Trajectory,
    rng: np.random.Generator,
    *,
    noise: EdgeNoise | None = None,
    visible: NDArray[np.bool_] | None = None,
) -> list[Edges]:
    """Return one `Edges` for each pose of `truth` (T): the landmarks (L) in view, measured with independent noise.

    Both ends of each visible segment err across it by N(0, endpoint_sigma_px). To first order this moves lean and
    bearing by Gaussians with exactly the sigmas that the edges state (design equation 7); `landmark_id` is the true
    index in the map, -1 for clutter. visible: (T, L), which landmarks nothing hides; all when not given.
    """
    noise = noise or EdgeNoise()
    true = _visible_segments(landmark_map, camera, truth.poses, noise, visible)
    found = rng.random(len(true.frame)) < noise.detection_probability
    true = _Segments._make(column[found] for column in true)
    if noise.along_sigma_px or noise.cut_probability:
        true = true._replace(e=_shortened(true.e, camera, noise, rng))
    both = [np.concatenate(columns) for columns in zip(true, _clutter(camera, len(truth), noise, rng), strict=True)]
    order = np.argsort(both[0], kind="stable")
    segments = _Segments._make(column[order] for column in both)
    edges = _measured(segments, camera, noise.endpoint_sigma_px, rng)
    if landmark_map.polarity.any():
        edges = replace(edges, polarity=_polarity(landmark_map, segments.landmark, noise.turned_probability, rng))
    first = np.searchsorted(segments.frame, np.arange(len(truth) + 1))
    return [edges.take(np.arange(start, stop)) for start, stop in pairwise(first)]


def _visible_segments(
    landmark_map: LandmarkMap, camera: Camera, poses: Array, noise: EdgeNoise, visible: NDArray[np.bool_] | None
) -> _Segments:
    right, ahead = in_camera(camera.pose_in_map(poses), landmark_map.points)
    range_m = np.hypot(right, ahead)
    candidate = (ahead > 1e-6) & (range_m >= noise.range_min_m) & (range_m <= noise.range_max_m)
    if visible is not None:
        candidate &= visible
    frame, landmark = np.nonzero(candidate)
    ahead, tangent = ahead[frame, landmark], (right / np.where(ahead == 0, 1.0, ahead))[frame, landmark]
    e = upright_ends(camera, tangent, ahead, landmark_map.bottom_m[landmark], landmark_map.top_m[landmark])
    scale = camera.focal_px * np.hypot(1.0, np.sin(camera.mount.tilt_rad) * tangent)
    seen = (e[:, 1] - e[:, 0]) * scale >= max(noise.length_min_px, 1e-9)
    return _Segments(frame[seen], landmark[seen], tangent[seen], e[seen])


def upright_ends(camera: Camera, tangent: Array, ahead_m: Array, bottom_m: Array, top_m: Array) -> Array:
    """Return the upright image heights e (P, 2) of both ends of vertical edges, cut to the image's rectangle.

    tangent: (P,) tan(bearing). ahead_m: (P,) > 0. bottom_m, top_m: (P,) heights above the floor; nan is unlimited.
    The first exceeds the second where nothing is inside the image.
    """
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    a_left, a_right, e_low, e_high = camera.upright_bounds
    low = np.full(tangent.shape, e_low)
    high = np.full(tangent.shape, e_high)
    for height, limit, narrow in ((bottom_m, low, np.fmax), (top_m, high, np.fmin)):
        above = height - camera.mount.height_m
        depth = ahead_m * c - above * s
        # A point beside or behind the image plane lies beyond every border.
        e = np.divide(above * c + ahead_m * s, depth, out=np.copysign(np.inf, above), where=depth > 1e-9)
        limit[:] = narrow(limit, np.where(np.isnan(height), np.nan, e))
    # a = tan b (c + e s) must stay between the left and the right border.
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(tangent > 0, a_right, a_left) / tangent
        crossing = (np.where(tangent == 0, np.inf, reach) - c) / s
    if s > 1e-12:
        high = np.minimum(high, crossing)
    elif s < -1e-12:
        low = np.maximum(low, crossing)
    else:
        high = np.where((tangent >= a_left / c) & (tangent <= a_right / c), high, -np.inf)
    return np.stack([low, high], axis=-1)


def _clutter(camera: Camera, frames: int, noise: EdgeNoise, rng: np.random.Generator) -> _Segments:
    """Return false edges: lines through the nadir point, uniform over the image; others would be rejected."""
    count = rng.poisson(noise.clutter_per_frame, size=frames)
    frame = np.repeat(np.arange(frames), count)
    a_left, a_right, e_low, e_high = camera.upright_bounds
    shortest = noise.length_min_px / camera.focal_px
    length = rng.uniform(shortest, max(shortest, (e_high - e_low) / 2), size=len(frame))
    middle = rng.uniform(e_low + length / 2, e_high - length / 2)
    depth = np.cos(camera.mount.tilt_rad) + middle * np.sin(camera.mount.tilt_rad)
    tangent = rng.uniform(a_left, a_right, size=len(frame)) / depth
    e = middle[:, None] + length[:, None] * np.array([-0.5, 0.5])
    return _Segments(frame, np.full(len(frame), -1, dtype=np.int64), tangent, e)


def _shortened(e: Array, camera: Camera, noise: EdgeNoise, rng: np.random.Generator) -> Array:
    """Return upright heights (P, 2) of both ends as they are found: not quite there, or well short of it."""
    length = e[:, 1:] - e[:, :1]
    short = (rng.random(e.shape) < noise.cut_probability) * rng.uniform(0.0, MOST_CUT, e.shape)
    cut = e + np.array([1.0, -1.0]) * short * length
    found = cut + noise.along_sigma_px / camera.focal_px * rng.standard_normal(e.shape)
    return np.where(found[:, :1] < found[:, 1:], found, cut)


def _polarity(
    landmark_map: LandmarkMap, landmark: NDArray[np.int64], turned: float, rng: np.random.Generator
) -> NDArray[np.int8]:
    """Return the polarity (E,) of edges of landmarks (E,), of clutter either."""
    sign = np.where(rng.random(len(landmark)) < turned, -1, 1) * landmark_map.polarity[landmark]
    return np.where(landmark >= 0, sign, rng.choice([-1, 1], len(landmark))).astype(np.int8)


def _measured(segments: _Segments, camera: Camera, sigma_px: float, rng: np.random.Generator) -> Edges:
    """Return segments with noise on their ends, and with lean, bearing and sigmas to first order in that noise."""
    tilt, tangent, e = camera.mount.tilt_rad, segments.tangent, segments.e
    lean = np.arctan(np.sin(tilt) * tangent)
    length = (e[:, 1] - e[:, 0]) / np.cos(lean)
    sigma = sigma_px / camera.focal_px
    shift = sigma * rng.standard_normal(e.shape)
    # Line through the nadir point: tan b = Σ a n / Σ n² with n = c + e s; an end that moves across the line by δ
    # moves its a, at the same height, by δ / cos(lean).
    from_nadir = np.cos(tilt) + e * np.sin(tilt)
    power = (from_nadir**2).sum(axis=1)
    per_tangent = 1.0 / (1.0 + tangent**2)
    bearing_noise = per_tangent * (shift * from_nadir).sum(axis=1) / np.cos(lean) / power
    across = np.stack([np.cos(lean), -np.sin(lean)], axis=-1)
    ends = np.stack([tangent[:, None] * from_nadir, e], axis=-1) + shift[..., None] * across[:, None, :]
    return Edges.from_columns(
        bearing=np.arctan(tangent) + bearing_noise,
        bearing_sigma=per_tangent * sigma / np.cos(lean) / np.sqrt(power),
        lean=geometry.wrap_half_turn(lean + (shift[:, 1] - shift[:, 0]) / length),
        lean_sigma=np.sqrt(2) * sigma / length,
        length_px=length * camera.focal_px,
        ends_px=camera.pixels_from_upright(ends),
        landmark_id=segments.landmark,
    )


def visible_mask(structure: Structure, camera: Camera, robot_poses: Array) -> NDArray[np.bool_]:
    """Return which landmarks (T, L) are seen at all from robots at (T, 3)."""
    mask = np.zeros((len(robot_poses), len(structure.landmark_map)), dtype=bool)
    for row, pose in zip(mask, robot_poses, strict=True):
        row[visible_landmarks(structure, camera, pose).landmark] = True
    return mask
