"""Landmarks from known poses: follow, triangulate, join, associate again; and of images too far apart to follow edges.

Where images are far apart, every edge is a ray on the floor, and rays of edges that look alike cross at hypotheses
(docs/mapping.md). The score of a hypothesis compares two cases for every image: that it shows the hypothesis, at most
once, and that its edges are of other things.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, forward, wrap_angle
from localiser.mapping.landmarks import Built, fit_landmarks, join_tracks, long_enough, renumber
from localiser.mapping.sightings import Index, Sightings, direction_of, per_point
from localiser.mapping.tracks import MappingParameters, assign, association_scores, looks_alike

# -- associate again --------------------------------------------------------------------------------------------------


def reassociate(
    sightings: Sightings, built: Built, cameras: Array, sigma: Array, parameters: MappingParameters, margin: float = 0.0
) -> Index:
    """Return the landmark (S,) of each sighting, -1 for none; see `Sightings`. cameras: (T, 3). sigma: (S,) rad.
    margin: see `assign`.

    A landmark competes for the edges of a frame when it is seen shortly before or after it: farther off it may be
    hidden, and then some other edge in its direction would be taken for it.
    """
    live = _live(sightings, built, parameters.tracks.missed_most + 1)
    of = np.full(len(sightings), -1, dtype=np.int64)
    cov = built.cov
    for frame in range(sightings.frames):
        seen = np.arange(sightings.first[frame], sightings.first[frame + 1])
        landmark = live[frame]
        if len(seen) and len(landmark):
            from_here = np.tile(cameras[frame], (len(landmark), 1))
            expected, _ = direction_of(built.fit.points[landmark], from_here)
            jacobian = per_point(built.fit.points[landmark], from_here)
            own = np.einsum("li,lij,lj->l", jacobian, cov[landmark], jacobian)
            looks = looks_alike(
                built.side[landmark, None],
                built.polarity[landmark, None],
                sightings.side[seen],
                sightings.polarity[seen],
            )
            heading = cameras[frame, 2] - sightings.bearing[seen]
            score = association_scores(expected, own, heading, sigma[seen], looks, parameters.tracks)
            row, column = assign(score, margin)
            of[seen[column]] = landmark[row]
    return of


def _live(sightings: Sightings, built: Built, reach: int) -> list[Index]:
    """Return for each frame the landmarks that are seen within `reach` frames of it."""
    from scipy.ndimage import binary_dilation

    seen: NDArray[np.bool_] = np.zeros((sightings.frames, len(built)), dtype=bool)
    seen[sightings.frame[built.used], built.of[built.used]] = True
    return [np.flatnonzero(row) for row in binary_dilation(seen, np.ones((2 * reach + 1, 1)))]


# -- until nothing changes --------------------------------------------------------------------------------------------

_ROUNDS = 6


def build_from_poses(
    sightings: Sightings, track: Index, cameras: Array, sigma: Array, parameters: MappingParameters
) -> Built:
    """Return the landmarks that tracks (S,) make, seen from cameras (T, 3), with bearing errors sigma (S,) rad."""
    built = join_tracks(sightings, long_enough(track), cameras, sigma, parameters)
    for _ in range(_ROUNDS):
        of = reassociate(sightings, built, cameras, sigma, parameters)
        if (of == built.of).all():
            break
        built = join_tracks(sightings, with_leftovers(of, track), cameras, sigma, parameters)
    return built


def with_leftovers(of: Index, track: Index) -> Index:
    """Return the landmarks `of` (S,), and what no landmark took as groups by its tracks (S,)."""
    left = of < 0
    rest = long_enough(np.where(left, track, -1))
    return renumber(long_enough(np.where(left & (rest >= 0), rest + of.max(initial=-1) + 1, of)))


# -- images that are far apart ----------------------------------------------------------------------------------------

POSE_SIGMA_RAD = 3e-3
"""How far true headings are off at an image, one sigma: motion capture and clocks are no better."""
FAR_M, FAR_RAD = 0.2, np.deg2rad(6.0)
"""Between images that are farther apart than this (median) edges are not followed."""
_CELL_M = 0.04
_NEAREST_M = 0.4
_CROSSING_RAD = np.deg2rad(5.0)  # rays that cross at less say too little of where
_MOST_HYPOTHESES = 3000
_GATE = 3.0  # sigmas
_FOUND = 0.6  # chance that an image shows what it has in view
_MISSED = 0.35  # nats that an image costs which has it in view and shows it not: mostly it is hidden
_ALIKE = 0.0  # log-likelihood ratio of looks from which two edges may be one
_CLEAR = 1.0  # nats by which an edge must be likelier of its landmark than of another
_LEAST_SCORE = 6.0  # nats of a landmark against edges of other things
_FEWEST_IMAGES = 4
_FAR_ROUNDS = 4


def are_far(poses: Array) -> bool:
    """Return whether images at poses (T, 3) are too far apart to follow an edge from one to the next."""
    step = np.diff(poses, axis=0)
    if not len(step):
        return False
    far = np.hypot(step[:, 0], step[:, 1]) / FAR_M + np.abs(wrap_angle(step[:, 2])) / FAR_RAD
    return bool(np.median(far) > 1.0)


def build_from_far_images(
    paths: Sequence[Array], sightings: Sightings, sigma: Array, parameters: MappingParameters
) -> tuple[Built, Array] | None:
    """Return the landmarks (L) where rays cross, and how likely each exists (L,); None where images are near.

    paths: camera poses (T, 3) of each log, of which the images of one at least are too far apart to follow an edge from
    one to the next. sigma: (S,) rad of the bearings, without the errors of poses.
    """
    if not any(are_far(path) for path in paths):
        return None
    cameras = np.concatenate(paths)
    rays = _Rays(sightings, cameras, np.hypot(sigma, POSE_SIGMA_RAD), parameters.range_max_m)
    of = renumber(long_enough(_greedy(rays, rays.hypotheses()), _FEWEST_IMAGES))
    built = fit_landmarks(sightings, of, cameras, rays.sigma)
    for _ in range(_FAR_ROUNDS):
        again = renumber(long_enough(_shared(rays, built), _FEWEST_IMAGES))
        if (again == built.of).all():
            break
        built = fit_landmarks(sightings, again, cameras, rays.sigma)
    return built, _existence(rays, built)


class _Rays:
    """The edges (S,) as rays on the floor. camera: (S, 3). heading, sigma: (S,) rad. clutter: edges a radian."""

    def __init__(self, sightings: Sightings, cameras: Array, sigma: Array, reach_m: float) -> None:
        self.sightings, self.cameras, self.sigma, self.reach_m = sightings, cameras, sigma, reach_m
        self.camera = cameras[sightings.frame]
        self.heading = wrap_angle(self.camera[:, 2] - sightings.bearing)
        self.half_view = float(np.abs(sightings.bearing).max(initial=0.1))
        self.clutter = len(sightings) / max(sightings.frames, 1) / (2 * self.half_view)

    def hypotheses(self) -> Array:
        """Return the places (H, 2) where rays of edges that look alike cross, those of most crossings first."""
        s, ahead, found = self.sightings, forward(self.heading), []
        for one in range(len(s)):
            other = np.arange(s.first[s.frame[one] + 1], len(s))
            cross = ahead[one, 0] * ahead[other, 1] - ahead[one, 1] * ahead[other, 0]
            other, cross = other[np.abs(cross) > np.sin(_CROSSING_RAD)], cross[np.abs(cross) > np.sin(_CROSSING_RAD)]
            base = self.camera[other, :2] - self.camera[one, :2]
            first = (base[:, 0] * ahead[other, 1] - base[:, 1] * ahead[other, 0]) / cross
            second = (base[:, 0] * ahead[one, 1] - base[:, 1] * ahead[one, 0]) / cross
            near = np.minimum(first, second) > _NEAREST_M
            near &= np.maximum(first, second) < self.reach_m
            other, first = other[near], first[near]
            looks = looks_alike(s.side[one], s.polarity[one], s.side[other], s.polarity[other])
            found.append(self.camera[one, :2] + first[looks > _ALIKE, None] * ahead[one])
        return _densest(np.concatenate(found) if found else np.zeros((0, 2)))

    def explained(self, point: Array, free: NDArray[np.bool_]) -> tuple[float, Index]:
        """Return the score of a landmark at a point (2,), and the edges that show it, of those that are `free` (S,)."""
        s = self.sightings
        expected, range_m = direction_of(np.broadcast_to(point, (len(s), 2)), self.camera)
        off = wrap_angle(self.heading - expected)
        near = np.flatnonzero(free & (np.abs(off) < _GATE * self.sigma) & (range_m < self.reach_m))
        if len(near) < _FEWEST_IMAGES:
            return -np.inf, near
        fit = np.log(_FOUND / (self.clutter * self.sigma[near] * np.sqrt(2 * np.pi)))
        fit -= 0.5 * (off[near] / self.sigma[near]) ** 2
        # As each of the edges looks: that which makes most of the others alike is how the landmark looks.
        looks = looks_alike(s.side[near, None], s.polarity[near, None], s.side[near], s.polarity[near])
        gain = np.maximum(fit + looks, 0.0)
        frame, index = np.unique(s.frame[near], return_inverse=True)
        best = np.zeros((len(near), len(frame)))
        np.maximum.at(best.T, index, gain.T)
        row = int(best.sum(axis=1).argmax())
        shown = near[(gain[row] > 0) & (gain[row] == best[row][index])]
        heading, range_m = direction_of(np.broadcast_to(point, (len(self.cameras), 2)), self.cameras)
        in_view = (np.abs(wrap_angle(heading - self.cameras[:, 2])) < self.half_view) & (range_m < self.reach_m)
        missed = int(in_view.sum()) - len(np.unique(s.frame[shown]))
        return float(best[row].sum() - _MISSED * max(missed, 0)), shown


def _densest(points: Array) -> Array:
    """Return the middles (H, 2) of the cells that hold more points (P, 2) than those around them, the fullest first."""
    from scipy.ndimage import maximum_filter, uniform_filter

    if not len(points):
        return points
    low = points.min(axis=0)
    cell = ((points - low) / _CELL_M).astype(np.int64)
    count = np.zeros(cell.max(axis=0) + 1)
    np.add.at(count, (cell[:, 0], cell[:, 1]), 1.0)
    smooth = uniform_filter(count, 3, mode="constant")
    peak = np.argwhere((smooth == maximum_filter(smooth, 3)) & (smooth > 0))
    best = peak[np.argsort(-smooth[peak[:, 0], peak[:, 1]], kind="stable")[:_MOST_HYPOTHESES]]
    return np.asarray(low + _CELL_M * (best + 0.5))


def _greedy(rays: _Rays, hypotheses: Array) -> Index:
    """Return the landmark (S,) of each edge, -1 for none: the likeliest first, each of what those before it left."""
    free = np.ones(len(rays.sightings), dtype=bool)
    of = np.full(len(rays.sightings), -1, dtype=np.int64)
    queue = [(-np.inf, index) for index in range(len(hypotheses))]
    places = hypotheses.copy()
    count = 0
    while queue:
        stated, index = heapq.heappop(queue)
        score, shown = rays.explained(places[index], free)
        if score < _LEAST_SCORE or len(shown) < _FEWEST_IMAGES:
            continue
        if stated == -np.inf:
            alone = np.full(len(rays.sightings), -1, dtype=np.int64)
            alone[shown] = 0
            places[index] = fit_landmarks(rays.sightings, alone, rays.cameras, rays.sigma).fit.points[0]
            score, shown = rays.explained(places[index], free)
        # What was claimed since makes a score fall, never rise.
        if queue and -score > queue[0][0]:
            if score >= _LEAST_SCORE:
                heapq.heappush(queue, (-score, index))
            continue
        if score >= _LEAST_SCORE and len(shown) >= _FEWEST_IMAGES:
            of[shown], free[shown] = count, False
            count += 1
    return of


def _existence(rays: _Rays, built: Built) -> Array:
    """Return the probability (L,) that each landmark exists, by how well it explains the edges that are its own.

    Against it counts how many other places in view there are where as much might have been explained by chance: the
    area in view over that of the landmark's covariance.
    """
    area = rays.half_view * rays.reach_m**2
    volume = np.log(2 * np.pi * np.sqrt(np.linalg.det(built.cov)) / area)
    odds = np.minimum(volume, 0.0)
    for landmark in range(len(built)):
        odds[landmark] += rays.explained(built.fit.points[landmark], built.of == landmark)[0]
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(odds, -30.0, 30.0))))


def _shared(rays: _Rays, built: Built) -> Index:
    """Return the landmark (S,) of each edge when all landmarks compete for the edges of each image, -1 for none."""
    s, of = rays.sightings, np.full(len(rays.sightings), -1, dtype=np.int64)
    for frame in range(s.frames):
        seen = np.arange(s.first[frame], s.first[frame + 1])
        if not len(seen) or not len(built):
            continue
        camera = np.tile(rays.cameras[frame], (len(built), 1))
        expected, range_m = direction_of(built.fit.points, camera)
        off = wrap_angle(rays.heading[seen] - expected[:, None])
        looks = looks_alike(built.side[:, None], built.polarity[:, None], s.side[seen], s.polarity[seen])
        score = np.log(_FOUND / (rays.clutter * rays.sigma[seen] * np.sqrt(2 * np.pi)))
        score = score - 0.5 * (off / rays.sigma[seen]) ** 2 + looks
        score[(np.abs(off) > _GATE * rays.sigma[seen]) | (range_m > rays.reach_m)[:, None]] = -np.inf
        row, column = assign(score, _CLEAR)
        of[seen[column]] = row
    return of
