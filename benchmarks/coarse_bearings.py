"""Landmarks from coarse bearings at known poses: a mixture model, found by expectation-maximisation.

With `coarse_bearings` in `mapping.BUILDERS`, `build_map` uses it where bearings are worse than half a degree.

Where the error of a bearing is larger than the distance between landmarks, tracks mix neighbours. All bearings together
still distinguish them, so nothing is tracked. A Hough transform finds the cells of the floor that most rays cross:
these are the candidates. Expectation-maximisation then finds which candidates explain the bearings, where they are, and
how accurate the bearings are. All candidates begin with the same weight. A candidate that explains less than its two
coordinates cost loses its weight [Figueiredo, Jain 2002].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, forward, wrap_angle
from localiser.mapping import (
    COARSE_RAD,
    Built,
    Index,
    MappingParameters,
    Sightings,
    fit_landmarks,
    long_enough,
    renumber,
)

_CELL_M, _MOST_CELLS = 0.05, 4_000_000
_NEAREST_M = 0.3
_VAGUE_M = 0.3  # a ray that is off by more than this says too little of where its landmark stands
_VOTE_SHARE = 0.5  # sharpness of votes: half of the stated error, or neighbours make one peak between them
_LEAST_VOTES = 15.0  # nats of a candidate
_SIGHTINGS_EACH, _MOST_CANDIDATES = 8, 400
_FOUND = 0.8
_FIRST_SHARE, _FIRST_CLUTTER = 0.2, 0.3  # chance to be seen in an image; share of sightings that are clutter
_COST = 2.0  # sightings that the two coordinates of a landmark are worth
_FEWEST = 3.0  # sightings beyond that cost
_STEADY = 0.95  # the error of bearings shrinks by no more than this a round: slowly, or neighbours never part
_BEST_SHARE = 0.2  # nor below this share of what is stated
_SAME_M = 0.02
_LONGEST_STEP_M = 0.1
_ROUNDS, _LAST_ROUNDS = 60, 5
_LEAST_SHARE = 0.03  # a landmark that fewer of the images show which have it in view was there for a while only
_AT_ONCE = 4096


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Bearings (S,): from where (S, 3), along which heading (S,), one over the number of its frame's bearings (S,).

    half_view_rad, reach_m: what is in view.
    """

    camera: Array
    heading: Array
    per_frame: Array
    half_view_rad: float
    reach_m: float

    @property
    def frames(self) -> float:
        return float(self.per_frame.sum())


@dataclass(frozen=True, slots=True, eq=False)
class _Mixture:
    """Landmarks at (L, 2), the chance (L,) that an image with each in view shows it; clutter per image; sigma (rad)."""

    points: Array
    share: Array
    clutter: float
    sigma: float


def landmarks_of_coarse_bearings(sightings: Sightings, cameras: Array, sigma: Array, range_max_m: float) -> Index:
    """Return the landmark (S,) of each sighting, -1 for clutter; see `Sightings`.

    cameras: (T, 3) floor poses. sigma: (S,) rad; true errors may be a fraction of it. A landmark has at most one
    sighting a frame.
    """
    if len(sightings) == 0:
        return np.zeros(0, dtype=np.int64)
    stated = float(np.median(sigma))
    count = np.diff(sightings.first)[sightings.frame]
    camera = cameras[sightings.frame]
    half_view = max(float(np.abs(sightings.bearing).max()), COARSE_RAD)
    reach = min(range_max_m, _VAGUE_M / stated)
    rays = _Rays(camera, wrap_angle(camera[:, 2] - sightings.bearing), 1.0 / count, half_view, reach)
    points = _candidates(rays, _VOTE_SHARE * stated)
    clutter = _FIRST_CLUTTER * len(sightings) / rays.frames
    mixture = _Mixture(points, np.full(len(points), _FIRST_SHARE), clutter, stated)
    for _ in range(_ROUNDS):
        mixture = _improved(mixture, rays, stated)
    lasting = mixture.share >= _LEAST_SHARE
    mixture = replace(mixture, points=mixture.points[lasting], share=mixture.share[lasting])
    for _ in range(_LAST_ROUNDS):
        mixture = _improved(mixture, rays, stated)
    return _shared_out(mixture, rays, sightings.frame)


def _candidates(rays: _Rays, sigma: float) -> Array:
    """Return the points (L, 2) where more rays cross than around them, the most crossed first."""
    from scipy.ndimage import maximum_filter

    low = rays.camera[:, :2].min(axis=0) - rays.reach_m
    extent = np.ptp(rays.camera[:, :2], axis=0) + 2 * rays.reach_m
    cell = max(_CELL_M, float(np.sqrt(extent.prod() / _MOST_CELLS)))
    shape = np.ceil(extent / cell).astype(np.int64) + 1
    votes = _votes(rays, sigma, low, cell, shape)
    peak = np.argwhere((votes == maximum_filter(votes, 3)) & (votes > _LEAST_VOTES))
    most = min(len(rays.heading) // _SIGHTINGS_EACH, _MOST_CANDIDATES)
    best = peak[np.argsort(-votes[peak[:, 0], peak[:, 1]], kind="stable")][:most]
    return np.asarray(low + cell * (best + 0.5))


def _votes(rays: _Rays, sigma: float, low: Array, cell: float, shape: Index) -> Array:
    """Return the log-likelihood ratio of a landmark in each cell (X, Z) against clutter, of all rays near to it."""
    ahead = forward(rays.heading)
    across = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    density = len(rays.heading) / rays.frames / (2 * rays.half_view_rad)
    votes = np.zeros(int(shape.prod()))
    for range_m in np.arange(_NEAREST_M, rays.reach_m, cell):
        spread = float(np.hypot(sigma, cell / np.sqrt(12) / range_m))  # blurred by the cell
        middle = rays.camera[:, :2] + range_m * ahead
        widest = int(np.ceil(3 * spread * range_m / cell))
        for step in range(-widest, widest + 1):
            off = step * cell / range_m
            likelihood = np.exp(-0.5 * (off / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
            at = ((middle + step * cell * across - low) / cell).astype(np.int64)
            at = np.clip(at, 0, shape - 1)
            votes += np.log1p(_FOUND / density * likelihood) * np.bincount(
                at[:, 0] * shape[1] + at[:, 1], None, len(votes)
            )
    return votes.reshape(tuple(shape))


def _improved(mixture: _Mixture, rays: _Rays, stated: float) -> _Mixture:
    """Return the mixture after one round of expectation and maximisation, without what explains too little."""
    count = len(mixture.points)
    seen, in_view, squares, clutter = np.zeros(count), np.zeros(count), 0.0, 0.0
    normal, gradient = np.zeros((count, 3)), np.zeros((count, 2))
    for start in range(0, len(rays.heading), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        weight, free, shown, residual, jacobian = _responsibilities(mixture, rays, part)
        seen += weight.sum(axis=0)
        in_view += (shown * rays.per_frame[part, None]).sum(axis=0)
        squares += float((weight * residual**2).sum())
        clutter += float(free.sum())
        x, z = jacobian
        normal += np.stack([(weight * term).sum(axis=0) for term in (x * x, x * z, z * z)], axis=-1)
        gradient += np.stack([(weight * residual * term).sum(axis=0) for term in (x, z)], axis=-1)
    worth = seen - _COST
    kept = np.flatnonzero((worth > _FEWEST) & ~_doubled(mixture.points, seen))
    spread = float(np.sqrt(squares / max(seen.sum(), 1.0)))
    return _Mixture(
        (mixture.points + _steps(normal, gradient, mixture.sigma))[kept],
        np.minimum(worth / (in_view + 1), 0.95)[kept],
        max(clutter / rays.frames, 0.02),
        float(np.clip(spread, max(_STEADY * mixture.sigma, _BEST_SHARE * stated), stated)),
    )


def _responsibilities(
    mixture: _Mixture, rays: _Rays, part: slice
) -> tuple[Array, Array, NDArray[np.bool_], Array, tuple[Array, Array]]:
    """Return for rays (K) how likely each is of each landmark (K, L) and of none (K,), and what that follows from.

    Also: which landmarks are in view (K, L), residuals (K, L) rad, derivatives of the heading by x and z, (K, L) each.
    """
    camera = rays.camera[part]
    x, z = (mixture.points[None, :, i] - camera[:, None, i] for i in (0, 1))
    squared = np.maximum(x**2 + z**2, 1e-6)
    ray, axis = (forward(heading)[:, None] for heading in (rays.heading[part], camera[:, 2]))
    residual = np.arctan2(ray[..., 0] * z - ray[..., 1] * x, ray[..., 0] * x + ray[..., 1] * z)
    shown = axis[..., 0] * x + axis[..., 1] * z > np.cos(rays.half_view_rad) * np.sqrt(squared)
    shown &= squared < rays.reach_m**2
    scale = mixture.share / (mixture.sigma * np.sqrt(2 * np.pi))
    likelihood = np.where(shown, scale * np.exp(-0.5 * (residual / mixture.sigma) ** 2), 0.0)
    none = mixture.clutter / (2 * rays.half_view_rad)
    total = likelihood.sum(axis=1) + none
    return likelihood / total[:, None], none / total, shown, residual, (z / squared, -x / squared)


def _steps(normal: Array, gradient: Array, sigma: float) -> Array:
    """Return the damped Gauss-Newton steps (L, 2) m; normal: (L, 3) the matrices' xx, xz, zz, for sigma 1."""
    damping = 1e-3 * (normal[:, 0] + normal[:, 2]) + sigma**2
    a, b, d = normal[:, 0] + damping, normal[:, 1], normal[:, 2] + damping
    step = np.stack([d * gradient[:, 0] - b * gradient[:, 1], a * gradient[:, 1] - b * gradient[:, 0]], axis=-1)
    step /= (a * d - b**2)[:, None]
    length = np.hypot(step[:, 0], step[:, 1])[:, None]
    return np.asarray(step * np.minimum(1.0, _LONGEST_STEP_M / np.maximum(length, 1e-12)))


def _doubled(points: Array, seen: Array) -> NDArray[np.bool_]:
    """Return which landmarks (L,) stand where another one does that was seen more often."""
    near = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)) < _SAME_M
    rank = np.argsort(np.argsort(-seen, kind="stable"), kind="stable")
    return np.asarray((near & (rank[None] < rank[:, None])).any(axis=1))


def _shared_out(mixture: _Mixture, rays: _Rays, frame: Index) -> Index:
    """Return the likeliest landmark (S,) of each ray, -1 for clutter; of two in one frame only the likelier ray."""
    of, certain = np.full(len(frame), -1, dtype=np.int64), np.zeros(len(frame))
    if len(mixture.points) == 0:
        return of
    for start in range(0, len(frame), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        weight, free, *_ = _responsibilities(mixture, rays, part)
        best = weight.argmax(axis=1)
        certain[part] = weight.max(axis=1)
        of[part] = np.where(certain[part] > free, best, -1)
    order = np.lexsort((-certain, of, frame))
    again = (np.diff(of[order]) == 0) & (np.diff(frame[order]) == 0)
    of[order[1:][again]] = -1
    return of


def coarse_bearings(
    paths: Sequence[Array], sightings: Sightings, sigma: Array, parameters: MappingParameters
) -> tuple[Built, Array | None] | None:
    """Return the landmarks (L) of bearings too coarse to be followed, at true poses; see `mapping.Builder`.

    For bearings worse than `COARSE_RAD` (median). How likely each landmark exists is told later.
    """
    if not np.median(sigma) > COARSE_RAD:
        return None
    cameras = np.concatenate(paths)
    of = landmarks_of_coarse_bearings(sightings, cameras, sigma, parameters.range_max_m)
    return fit_landmarks(sightings, renumber(long_enough(of)), cameras, sigma), None


def matched(places: Array, points: Array) -> Array:
    """Return how far (L,) each place is from the point that is its own; each point is of one place."""
    from scipy.optimize import linear_sum_assignment

    apart = np.linalg.norm(places[:, None] - points[None], axis=-1)
    row, column = linear_sum_assignment(np.minimum(apart, 1.0))
    error = np.full(len(places), np.inf)
    error[row] = apart[row, column]
    return error
