"""Pose hypotheses: poses at which chosen edges would be chosen landmarks: two feet, three bearings, or a marker.

Each function draws as many hypotheses as requested, at random among all combinations that do not contradict the
measurements. A random part of a large set keeps one image cheap; the next image draws another part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Indices, forward, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.observation import ENDPOINT_SIGMA_PX, Frame, ObservationParameters, end_per_height, marked_landmarks

BOTTOM_STEP_M = 0.05  # landmarks whose lower ends differ by less are searched together
MANY_PAIRS = 400_000  # beyond which an image can try but a small part of what it may be
MOST_PAIRS = 5_000_000  # of landmarks in the table, 16 bytes each; about so many where there are more
PAIR_SIGMAS = 1.0  # narrow: more pairs of edges can be tried, which finds more than it loses
MOST_TRIPLES = 10  # times as many of landmarks as are tried: beyond that a right one is hardly ever among them
NARROWEST_RAD = np.radians(3.0)  # between two bearings: below it they fix hardly more than one does
FEWEST_TRIED = 4  # pairs of edges
# Part of the pairs, and of the triples, of edges that are all landmarks and pass the gates at the true pose.
BOTH_RIGHT, ALL_RIGHT = 0.3, 0.16
MOST_ASLANT_DEG, ASLANT_STEP_DEG = 75.0, 2.5  # directions from which a marker is read: 0.13 m apart at 3 m
WORST_RANGE = 0.25  # relative error of a range that still tells something


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkPairs:
    """Landmarks (L) of a map, and their ordered pairs (M) by distance.

    points: (L, 2) m. sigma_max_m: the largest error of a position. range_m: between which landmarks are seen. class_m:
    (B,) heights that lower ends are grouped to, ascending; 0 for unknown. pair: (M, 2) landmarks that can both be in
    sight, sorted by `key` (M,), their distance plus `step` for the group of the first times B plus that of the second.
    """

    points: Array
    sigma_max_m: float
    range_m: tuple[float, float]
    class_m: Array
    pair: NDArray[np.int32]
    key: Array
    step: float

    @classmethod
    def of(cls, landmark_map: LandmarkMap, parameters: ObservationParameters) -> LandmarkPairs:
        """Return the pairs of a map; where they would be more than `MOST_PAIRS`, about so many, the nearest."""
        from scipy.spatial import cKDTree

        points, sight = landmark_map.points, parameters.sight
        farthest_m, tree, neighbours = 2 * sight.range_max_m, cKDTree(points), MOST_PAIRS // len(points)
        if neighbours < len(points) - 1:
            farthest_m = min(farthest_m, float(np.median(tree.query(points, [neighbours + 1])[0])))
        one = tree.query_pairs(farthest_m, output_type="ndarray").astype(np.int32)
        distance = np.hypot(*(points[one[:, 0]] - points[one[:, 1]]).T)
        one, distance = one[distance > 1e-3], distance[distance > 1e-3]
        pair, distance = np.concatenate([one, one[:, ::-1]]), np.concatenate([distance, distance])

        height, group = np.unique(np.round(np.nan_to_num(landmark_map.bottom_m) / BOTTOM_STEP_M), return_inverse=True)
        step = 2.0 * sight.range_max_m + 1.0  # no distance reaches it
        key = (group[pair[:, 0]] * len(height) + group[pair[:, 1]]) * step + distance
        order = np.argsort(key, kind="stable")
        sigma_max_m, class_m = float(landmark_map.sigma_m(parameters.landmark_sigma_m).max()), height * BOTTOM_STEP_M
        return cls(points, sigma_max_m, (sight.range_min_m, sight.range_max_m), class_m, pair[order], key[order], step)

    def between(self, pair_class: Indices, low_m: Array, high_m: Array) -> tuple[Indices, Indices]:
        """Return for queries (Q,) the slice first … last (Q,) of the pairs of this class at low_m … high_m (Q,)."""
        first = np.searchsorted(self.key, pair_class * self.step + np.clip(low_m, 0.0, self.step - 1e-9))
        high = pair_class * self.step + np.clip(high_m, 0.0, self.step - 1e-9)
        return first, np.maximum(np.searchsorted(self.key, high, side="right"), first)


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

    @classmethod
    def of(cls, frame: Frame) -> Feet:
        """Return bearings and feet of the edges of an image, by their line or by their slope alone."""
        camera, known, (bearing, _) = frame.camera, np.flatnonzero(frame.is_known), frame.bearings
        order = known[np.argsort(bearing[known], kind="stable")]
        edges, bearing = frame.edges.take(order), bearing[order]
        ends, cut = frame.end_heights[0][order], frame.end_heights[1][order]
        unknown = np.isnan(ends).any(axis=1)
        mount, ahead = camera.mount, edges.foot_range_m * np.cos(bearing)
        s, c = np.sin(mount.tilt_rad), np.cos(mount.tilt_rad)
        by_range = (ahead * s - mount.height_m * c) / (ahead * c + mount.height_m * s)  # of a point on the floor
        foot = np.where(unknown, by_range, np.where(cut[:, 0], np.nan, ends[:, 0]))
        known_sigma = np.hypot(ENDPOINT_SIGMA_PX / camera.focal_px, edges.common.sigma_of("tilt"))
        by_height = edges.height_sigma_m * end_per_height(ends, camera)[:, 0]
        sigma = float(np.hypot(known_sigma, np.median(by_height[~unknown]) if not unknown.all() else 0.0))
        return cls(camera, bearing, foot, sigma, np.nan_to_num(edges.length_px, nan=1.0))

    def ranges(self, pairs: LandmarkPairs) -> tuple[Array, Array]:
        """Return range and its sigma (E, B), m, of every edge if its foot is at each height; nan where unknown."""
        s, c = np.sin(self.camera.mount.tilt_rad), np.cos(self.camera.mount.tilt_rad)
        drop = self.camera.mount.height_m - pairs.class_m
        fall = ((s - self.foot * c) / (c + self.foot * s))[:, None]  # of the line of sight, per metre ahead
        per_e = (1.0 / (c + self.foot * s) ** 2)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = drop / fall
            # Heights within a group are even over one step.
            relative = np.hypot(np.abs(per_e / fall) * self.foot_sigma, BOTTOM_STEP_M / np.sqrt(12) / np.abs(drop))
            range_m = ahead / np.cos(self.bearing)[:, None]
            told = (ahead > 0) & (relative < WORST_RANGE) & (range_m == np.clip(range_m, *pairs.range_m))
            return np.where(told, range_m, np.nan), np.where(told, range_m * relative, np.nan)


def from_feet(feet: Feet, pairs: LandmarkPairs, count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return camera poses (K ≤ count, 3) at which two edges, with the ranges of their feet, are two landmarks.

    Pairs of edges come first that are long, so hardly ever clutter, have sure ranges, and can be few pairs of
    landmarks. Of what can be very many, a random part is tried. The second value is how many poses are expected to be
    the true one: `BOTH_RIGHT` of the pairs of edges, times the part of all their pairs of landmarks that is tried.
    """
    ranges, sigmas = feet.ranges(pairs)
    known = np.isfinite(ranges).sum(axis=1)
    is_wide = feet.bearing - feet.bearing[:, None] >= NARROWEST_RAD
    i, j = np.nonzero(is_wide & (known > 0) & (known[:, None] > 0))
    if len(i) == 0:
        return np.zeros((0, 3)), 0.0

    # A query for every pair of edges and heights of their feet: which pairs of landmarks are as far apart?
    r_i, r_j = ranges[i, :, None], ranges[j, None, :]
    cos = np.cos(feet.bearing[j] - feet.bearing[i])[:, None, None]
    apart = np.sqrt(r_i**2 + r_j**2 - 2 * r_i * r_j * cos)
    sigma = np.hypot(sigmas[i, :, None] * (r_i - r_j * cos), sigmas[j, None, :] * (r_j - r_i * cos))  # to first order
    sigma /= np.maximum(apart, 1e-6)
    pair, one, other = np.nonzero(np.isfinite(apart))
    slack = PAIR_SIGMAS * sigma[pair, one, other] + 3 * pairs.sigma_max_m
    apart = apart[pair, one, other]
    first, last = pairs.between(one * len(pairs.class_m) + other, apart - slack, apart + slack)
    able = np.bincount(pair, last - first, minlength=len(i))

    # An exponential draw over merits, sorted, is a draw without putting back with chances in proportion to them.
    mean_sigma = np.nansum(sigmas, axis=1) / np.maximum(known, 1)
    merit = np.sqrt(feet.length_px[i] * feet.length_px[j]) / (mean_sigma[i] + mean_sigma[j])
    order = np.argsort(rng.exponential(size=len(i)) * able / merit)
    order = order[able[order] > 0]
    tried = np.minimum(able[order], count / FEWEST_TRIED)
    chosen = np.bincount(order[np.cumsum(tried) - tried < count], minlength=len(i)) > 0
    keep = np.flatnonzero(chosen[pair])
    part = np.minimum(1.0, count / FEWEST_TRIED / able[pair[keep]])
    each = np.floor((last - first)[keep] * part + rng.random(len(keep))).astype(np.int64)
    query = np.repeat(np.arange(len(keep)), each)
    place = np.arange(len(query)) - np.repeat(np.cumsum(each) - each, each)  # of as many as are tried of the query
    some = rng.permutation(len(query))[:count]
    entry = ((place[some] + rng.random(len(some))) / part[query[some]]).astype(np.int64)
    query = keep[query[some]]
    landmark = pairs.pair[np.minimum(first[query] + entry, last[query] - 1)]
    edges = np.stack([i, j], axis=-1)[pair[query]]
    measured = ranges[edges, np.stack([one[query], other[query]], axis=-1)]
    cameras = from_two_bearings(pairs.points[landmark], feet.bearing[edges], measured)
    return cameras, float(BOTH_RIGHT * len(i) * len(query) / max(able.sum(), 1))


def from_two_bearings(points: Array, bearings: Array, ranges: Array) -> Array:
    """Return the camera's poses (K, 3) that see two landmarks at two bearings exactly (docs/relocalisation.md, step 1).

    points: (K, 2, 2) landmarks in the map. bearings: (K, 2) rad. ranges: (K, 2), of which only the ratio counts.
    """
    ray = np.stack([np.sin(bearings), -np.cos(bearings)], axis=-1) * ranges[..., None]
    across, along = ray[:, 1] - ray[:, 0], points[:, 1] - points[:, 0]
    scale = np.hypot(along[:, 0], along[:, 1]) / np.hypot(across[:, 0], across[:, 1])
    # The rotation by h turns a vector's angle atan2(z, x) by -h.
    heading = np.arctan2(across[:, 1], across[:, 0]) - np.arctan2(along[:, 1], along[:, 0])
    turned = np.column_stack([np.zeros_like(along), heading])
    position = points[:, 0] - geometry.map_from_robot(turned, ray[:, 0] * scale[:, None])
    return np.column_stack([position, wrap_angle(heading)])


def from_bearings(feet: Feet, pairs: LandmarkPairs, count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return camera poses (K ≤ count, 3) at which three edges are three landmarks, and how many should be true.

    None where the map is so large that three right edges would hardly ever be drawn with their three landmarks.
    """
    edges, landmarks = len(feet.bearing), len(pairs.points)
    triples = landmarks * (landmarks - 1) * (landmarks - 2)
    if min(edges, landmarks) < 3 or triples > MOST_TRIPLES * count:
        return np.zeros((0, 3)), 0.0
    # Triples of distinct indices, in random order.
    edge, landmark = (np.argpartition(rng.random((count, of)), 2, axis=1)[:, :3] for of in (edges, landmarks))
    cameras = from_three_bearings(pairs.points[landmark], feet.bearing[edge])
    return cameras[np.isfinite(cameras).all(axis=1)], ALL_RIGHT * count / triples


def from_three_bearings(points: Array, bearings: Array) -> Array:
    """Return the camera's poses (K, 3) that see three landmarks at three bearings; nan where there is none.

    points: (K, 3, 2) landmarks in the map. bearings: (K, 3) rad, from the camera's forward axis, positive right.

    The first landmark is the origin, r (sin b₁, -cos b₁) from the camera. A landmark q lies on its ray when
    n·(Rᵀq + r (sin b₁, -cos b₁)) = 0 with n = (cos b, sin b) across the ray, R the rotation by the heading h. Two rays
    leave a line of solutions, the cross product of their rows, on which cos² h + sin² h = 1 and r > 0 pick a point.
    There is none where camera and landmarks lie on one circle.
    """
    nx, nz = np.cos(bearings[:, 1:]), np.sin(bearings[:, 1:])
    qx, qz = np.moveaxis(points[:, 1:] - points[:, :1], -1, 0)
    rows = np.stack([nx * qx + nz * qz, nz * qx - nx * qz, np.sin(bearings[:, :1] - bearings[:, 1:])], axis=-1)
    line = np.cross(rows[:, 0], rows[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        cos, sin, range_m = line.T * np.sign(line[:, 2]) / np.hypot(line[:, 0], line[:, 1])
    heading = np.arctan2(sin, cos)
    poses = np.column_stack([points[:, 0] - range_m[:, None] * forward(heading - bearings[:, 0]), heading])
    seen = geometry.robot_from_map(poses[:, None], points)
    is_ahead = (seen[..., 0] * np.sin(bearings) > seen[..., 1] * np.cos(bearings)).all(axis=1)
    poses[~is_ahead | (np.linalg.norm(line, axis=1) <= 1e-6)] = np.nan
    return poses


def from_markers(edges: Edges, landmark_map: LandmarkMap) -> Array:
    """Return camera poses (K, 3) from which a marker that the map has shows both its sides where they are seen.

    From everywhere on a circle through both sides they are as far apart. So there are poses for each direction from
    which the marker can be read.
    """
    marked, poses = marked_landmarks(edges, landmark_map), [np.zeros((0, 3))]
    turn = np.deg2rad(np.arange(-MOST_ASLANT_DEG, MOST_ASLANT_DEG + 1, ASLANT_STEP_DEG))
    for left in np.flatnonzero((marked >= 0) & (edges.landmark_id % 2 == 0)):  # those are the left sides
        for right in np.flatnonzero((edges.landmark_id == edges.landmark_id[left] - 1) & (marked >= 0)):
            ends, bearing = landmark_map.points[marked[[left, right]]], edges.bearing[[left, right]]
            across, apart = ends[1] - ends[0], bearing[1] - bearing[0]
            if apart > 0:
                range_m = np.hypot(*across) * np.cos(turn) / apart
                towards = np.arctan2(-across[1], across[0]) + turn  # heading of who looks at its middle
                middle = ends.mean(axis=0) - range_m[:, None] * forward(towards)
                poses.append(np.column_stack([middle, wrap_angle(towards + bearing.mean())]))
    return np.concatenate(poses)
