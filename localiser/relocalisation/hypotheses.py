"""Pose hypotheses: poses at which chosen edges would be chosen landmarks: two feet, three bearings, or a marker.

Each function draws as many hypotheses as requested, at random among all combinations that do not contradict the
measurements. A random part of a large set keeps one image cheap; the next image draws another part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, between, compose, forward, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.observation import ENDPOINT_SIGMA_PX, Frame, end_per_height, ends_lower_first, marked_landmarks
from localiser.relocalisation.places import BOTTOM_STEP_M, Indices, Places
from localiser.relocalisation.resection import from_three_bearings, from_two_bearings

GATE_SIGMAS = 1.0  # narrow: more pairs of edges can be tried, which finds more than it loses
MOST_TRIPLES = 10  # times as many of landmarks as are tried: beyond that a right one is hardly ever among them
NARROWEST_RAD = np.radians(3.0)  # between two bearings: below it they fix hardly more than one does
FEWEST_TRIED = 4  # pairs of edges
# Part of the pairs, and of the triples, of edges that are all landmarks and pass the gates at the true pose.
BOTH_RIGHT, ALL_RIGHT = 0.3, 0.16
MOST_ASLANT_DEG, ASLANT_STEP_DEG = 75.0, 2.5  # directions from which a marker is read: 0.13 m apart at 3 m
WORST_RANGE = 0.25  # relative error of a range that still tells something


@dataclass(frozen=True, slots=True, eq=False)
class Feet:
    """Bearings and feet of the E edges of one image whose bearing is known, left to right.

    bearing: (E,) rad. foot: (E,) upright image height of the lower end, nan where it is not known, or is the border of
    the image. foot_sigma: its error, the mount's included. length_px: (E,), 1 where it is not known.
    """

    camera: Camera
    bearing: Array
    foot: Array
    foot_sigma: float
    length_px: Array

    def __len__(self) -> int:
        return len(self.bearing)

    def robot_poses(self, camera_poses: Array) -> Array:
        """Return where in the map (N, 3) the robot is whose camera is at (N, 3)."""
        return compose(camera_poses, between(self.camera.robot_from_level, np.zeros(3)))


def feet_of(frame: Frame) -> Feet:
    """Return bearings and feet of the edges of an image, by their line or by their slope alone."""
    camera, known, (bearing, _) = frame.camera, np.flatnonzero(frame.is_known), frame.bearings
    order = known[np.argsort(bearing[known], kind="stable")]
    edges, bearing = frame.edges.take(order), bearing[order]
    ends, cut = ends_lower_first(edges.ends_px, camera)
    unknown = np.isnan(ends).any(axis=1)
    mount, ahead = camera.mount, edges.foot_range_m * np.cos(bearing)
    s, c = np.sin(mount.tilt_rad), np.cos(mount.tilt_rad)
    by_range = (ahead * s - mount.height_m * c) / (ahead * c + mount.height_m * s)  # of a point on the floor
    known_sigma = np.hypot(ENDPOINT_SIGMA_PX / camera.focal_px, edges.common.sigma_of("tilt"))
    by_height = edges.height_sigma_m * end_per_height(ends, camera)[:, 0]
    return Feet(
        camera=camera,
        bearing=bearing,
        foot=np.where(unknown, by_range, np.where(cut[:, 0], np.nan, ends[:, 0])),
        foot_sigma=float(np.hypot(known_sigma, np.median(by_height[~unknown]) if not unknown.all() else 0.0)),
        length_px=np.nan_to_num(edges.length_px, nan=1.0),
    )


def poses_of(feet: Feet, places: Places, count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return robot poses (K ≤ count, 3) in the region, and how many of those tried are expected to be the true one.

    Three bearings are tried where feet give less than half of the poses.
    """
    poses, hits = from_feet(feet, places, count, rng)
    if len(poses) < count // 2:
        more, more_hits = from_bearings(feet, places, count - len(poses), rng)
        poses, hits = np.concatenate([poses, more]), hits + more_hits
    return poses[places.region.contains(poses)], hits


def from_feet(feet: Feet, places: Places, count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return robot poses (K ≤ count, 3) at which two edges, with the ranges of their feet, are two landmarks.

    Two edges with ranges make two points, and only pairs of landmarks as far apart as these can be them. The bearings
    are then held exactly; of the ranges only the ratio counts. Pairs of edges come first that are long, so hardly ever
    clutter, have sure ranges, and can be few pairs of landmarks. Of what can be very many, a random part is tried.

    The second value is how many of the poses are expected to be the true one: `BOTH_RIGHT` of the pairs of edges, times
    the part of all their pairs of landmarks that is tried.
    """
    ranges, sigmas = _foot_ranges(feet, places)
    usable = np.flatnonzero(np.isfinite(ranges).any(axis=1))
    i, j = (usable[one] for one in np.triu_indices(len(usable), k=1))
    wide = feet.bearing[j] - feet.bearing[i] >= NARROWEST_RAD
    i, j = i[wide], j[wide]
    if len(i) == 0:
        return np.zeros((0, 3)), 0.0

    # A query for every pair of edges and heights of their feet: which pairs of landmarks are as far apart?
    r_i, r_j = ranges[i, :, None], ranges[j, None, :]
    cos = np.cos(feet.bearing[j] - feet.bearing[i])[:, None, None]
    apart = np.sqrt(r_i**2 + r_j**2 - 2 * r_i * r_j * cos)
    sigma = np.hypot(sigmas[i, :, None] * (r_i - r_j * cos), sigmas[j, None, :] * (r_j - r_i * cos))  # to first order
    sigma /= np.maximum(apart, 1e-6)
    pair, one, other = np.nonzero(np.isfinite(apart))
    slack = GATE_SIGMAS * sigma[pair, one, other] + 3 * places.sigma_max_m
    apart = apart[pair, one, other]
    first, last = places.pairs_between(one * len(places.class_m) + other, apart - slack, apart + slack)
    able = np.bincount(pair, last - first, minlength=len(i))

    # An exponential draw over merits, sorted, is a draw without putting back with chances in proportion to them.
    sure = np.nanmean(sigmas[usable], axis=1)[np.searchsorted(usable, [i, j])].sum(axis=0)
    merit = np.sqrt(feet.length_px[i] * feet.length_px[j]) / sure
    order = np.argsort(rng.exponential(size=len(i)) * able / merit)
    order = order[able[order] > 0]
    tried = np.minimum(able[order], count / FEWEST_TRIED)
    chosen = np.zeros(len(i), dtype=bool)
    chosen[order[np.cumsum(tried) - tried < count]] = True
    keep = np.flatnonzero(chosen[pair])
    part = np.minimum(1.0, count / FEWEST_TRIED / able[pair[keep]])
    each = np.floor((last - first)[keep] * part + rng.random(len(keep))).astype(np.int64)
    query = np.repeat(np.arange(len(keep)), each)
    place = np.arange(len(query)) - np.repeat(np.cumsum(each) - each, each)  # of as many as are tried of the query
    some = rng.permutation(len(query))[:count]
    query, place = query[some], place[some]
    entry = first[keep[query]] + ((place + rng.random(len(place))) / part[query]).astype(np.int64)
    landmark, query = places.pair[np.minimum(entry, last[keep[query]] - 1)], keep[query]
    edges = np.stack([i, j], axis=-1)[pair[query]]
    measured = np.stack([ranges[edges[:, 0], one[query]], ranges[edges[:, 1], other[query]]], axis=-1)
    points = places.points[landmark]
    cameras = from_two_bearings(points[:, 0], points[:, 1], feet.bearing[edges], measured)
    return feet.robot_poses(cameras), float(BOTH_RIGHT * len(i) * len(query) / max(able.sum(), 1))


def _foot_ranges(feet: Feet, places: Places) -> tuple[Array, Array]:
    """Return range and its sigma (E, B), m, of every edge if its foot is at each of the heights; nan where unknown.

    The foot at the upright height e falls (s - e c) / (c + e s) per metre ahead of the camera, which has a known
    height.
    """
    tilt, height_m = feet.camera.mount.tilt_rad, feet.camera.mount.height_m
    s, c = np.sin(tilt), np.cos(tilt)
    drop = height_m - places.class_m
    fall = ((s - feet.foot * c) / (c + feet.foot * s))[:, None]
    per_e = (1.0 / (c + feet.foot * s) ** 2)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = drop / fall
        relative = np.abs(per_e / fall) * feet.foot_sigma
        # Heights within a group are even over one step.
        relative = np.hypot(relative, BOTTOM_STEP_M / np.sqrt(12) / np.abs(drop))
        range_m = ahead / np.cos(feet.bearing)[:, None]
        told = (ahead > 0) & (relative < WORST_RANGE)
        told &= (range_m >= places.range_m[0]) & (range_m <= places.range_m[1])
        sigma_m = range_m * relative
    return np.where(told, range_m, np.nan), np.where(told, sigma_m, np.nan)


def from_bearings(feet: Feet, places: Places, count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return robot poses (K ≤ count, 3) at which three edges are three landmarks, and how many are expected to be true.

    None where the map is so large that three right edges would hardly ever be drawn with their three landmarks.
    """
    triples = len(places) * (len(places) - 1) * (len(places) - 2)
    if len(feet) < 3 or len(places) < 3 or triples > MOST_TRIPLES * count:
        return np.zeros((0, 3)), 0.0
    edges, landmarks = _drawn(len(feet), count, rng), _drawn(len(places), count, rng)
    cameras = from_three_bearings(places.points[landmarks], feet.bearing[edges])
    return feet.robot_poses(cameras[np.isfinite(cameras).all(axis=1)]), ALL_RIGHT * count / triples


def from_markers(camera: Camera, edges: Edges, landmark_map: LandmarkMap) -> Array:
    """Return camera poses (K, 3) from which a marker that the map has shows both its sides where they are seen.

    From everywhere on a circle through both sides they are as far apart. So there are poses for each direction from
    which the marker can be read.
    """
    marked, poses = marked_landmarks(edges, landmark_map), []
    for left in np.flatnonzero((marked >= 0) & (edges.landmark_id % 2 == 0)):  # those are the left sides
        for right in np.flatnonzero((edges.landmark_id == edges.landmark_id[left] - 1) & (marked >= 0)):
            ends, bearing = landmark_map.points[marked[[left, right]]], edges.bearing[[left, right]]
            across, apart = ends[1] - ends[0], bearing[1] - bearing[0]
            if apart > 0:
                turn = np.deg2rad(np.arange(-MOST_ASLANT_DEG, MOST_ASLANT_DEG + 1, ASLANT_STEP_DEG))
                range_m = np.hypot(*across) * np.cos(turn) / apart
                towards = np.arctan2(-across[1], across[0]) + turn  # heading of who looks at its middle
                middle = ends.mean(axis=0) - range_m[:, None] * forward(towards)
                poses.append(np.column_stack([middle, wrap_angle(towards + bearing.mean())]))
    return np.concatenate([*poses, np.zeros((0, 3))])


def _drawn(size: int, count: int, rng: np.random.Generator) -> Indices:
    """Return `count` triples (count, 3) of distinct indices below `size`, in random order."""
    return np.asarray(np.argpartition(rng.random((count, size)), 2, axis=1)[:, :3])
