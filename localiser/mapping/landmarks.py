"""Turn tracks into landmarks: triangulate them, join those of one edge, until nothing changes.

Whole tracks are associated, because a single edge often matches some landmark by chance. A sequence of edges with
directions that change as those of one point does not.

Triangulation is a robust least-squares problem of two unknowns for each landmark. It minimises
Σ ρ((φ_k - direction(point - camera_k)) / σ_k) with Cauchy's ρ by damped Gauss-Newton, all landmarks at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, forward, wrap_angle
from localiser.mapping.sightings import Index, Sightings, direction_of, per_point
from localiser.mapping.tracks import MappingParameters, looks_alike

# -- landmarks from bearings at known poses ---------------------------------------------------------------------------

CAUCHY = 2.0  # sigmas beyond which a bearing's say falls
_ITERATIONS = 30
_DAMPING, _MOST_DAMPING = 1e-3, 1e4
_SMALL_M = 1e-5  # a step below this is none


@dataclass(frozen=True, slots=True, eq=False)
class Triangulated:
    """Landmarks (L) and how the bearings (K) they were made of fit.

    points: (L, 2). information: (L, 2, 2) 1/m², of independent bearings. residual: (K,) rad. weight: (K,) 0…1, of the
    robust cost. depth_m: (K,) distance in front of the camera along the measured direction; negative is behind.
    chi2: (K,) squared residuals in sigmas.
    """

    points: Array
    information: Array
    residual: Array
    weight: Array
    depth_m: Array
    chi2: Array

    @property
    def cov(self) -> Array:
        """Covariance (L, 2, 2) m² of independent bearings; very large where bearings tell too little."""
        return inverse_information(self.information)


def inverse_information(information: Array) -> Array:
    """Return the covariances (L, 2, 2) m² of information (L, 2, 2) 1/m²; very large where there is too little."""
    trace = np.trace(information, axis1=1, axis2=2)[:, None, None]
    return np.asarray(np.linalg.inv(information + (1e-12 * trace + 1e-6) * np.eye(2)))


def triangulate(landmark: Index, count: int, cameras: Array, direction: Array, sigma: Array) -> Triangulated:
    """Return `count` landmarks (L) from bearings (K): landmark (K,): which one each is of, cameras (K, 2+): from where.

    direction, sigma: (K,) rad, headings in the map. A landmark without two different bearings has no information and
    stays where the linear solution is.
    """
    points = _linear(landmark, count, cameras, direction, sigma)
    active, damping = np.arange(count), np.full(count, _DAMPING)
    own, rays = landmark, [cameras[:, :2], direction, sigma]  # of the landmarks that still move
    for _ in range(_ITERATIONS):
        at, noise = points[active], rays[-1]
        residual, jacobian, weight = _linearised(at, own, *rays)
        normal, gradient = _normal(own, len(active), residual / noise, jacobian / noise[:, None], weight)
        diagonal = np.einsum("lii->li", normal)[:, :, None] * np.eye(2) + 1e-9 * np.eye(2)
        step = _solve(normal + damping[:, None, None] * diagonal, gradient)
        better = misfit(at + step, own, *rays) < _cost(own, len(active), residual / noise)
        points[active] = np.where(better[:, None], at + step, at)
        moves = (np.hypot(step[:, 0], step[:, 1]) >= _SMALL_M) & (better | (damping <= _MOST_DAMPING))
        if not moves.any():
            break
        damping, active = np.where(better, damping / 10, damping * 10)[moves], active[moves]
        kept = moves[own]
        own, rays = (np.cumsum(moves) - 1)[own[kept]], [column[kept] for column in rays]
    residual, jacobian, weight = _linearised(points, landmark, cameras, direction, sigma)
    normal, _ = _normal(landmark, count, residual / sigma, jacobian / sigma[:, None], weight)
    depth = ((points[landmark] - cameras[:, :2]) * forward(direction)).sum(axis=1)
    return Triangulated(points, normal, residual, weight, depth, (residual / sigma) ** 2)


def _linear(landmark: Index, count: int, cameras: Array, direction: Array, sigma: Array) -> Array:
    """Return the points (L, 2) nearest to all rays, each ray weighed by its bearing's certainty."""
    ahead = forward(direction)
    across = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    weight = np.minimum(sigma, 1.0) ** -2
    offset = (across * cameras[:, :2]).sum(axis=1)
    normal = _sum_by(landmark, count, weight[:, None, None] * across[:, :, None] * across[:, None, :])
    right = _sum_by(landmark, count, (weight * offset)[:, None] * across)
    middle = _sum_by(landmark, count, cameras[:, :2]) / np.maximum(np.bincount(landmark, minlength=count), 1)[:, None]
    # Rays that are all but parallel meet nowhere: a little regularisation keeps the point near the cameras.
    regular = 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-12 * np.eye(2)
    return middle + _solve(normal + regular, right - np.einsum("lij,lj->li", normal, middle))


def _linearised(
    points: Array, landmark: Index, cameras: Array, direction: Array, sigma: Array
) -> tuple[Array, Array, Array]:
    """Return residual (K,), Jacobian of the prediction (K, 2) and robust weight (K,)."""
    at = points[landmark]
    predicted, _ = direction_of(at, cameras)
    residual = wrap_angle(direction - predicted)
    return residual, per_point(at, cameras), 1.0 / (1.0 + (residual / (CAUCHY * sigma)) ** 2)


def misfit(points: Array, landmark: Index, cameras: Array, direction: Array, sigma: Array) -> Array:
    """Return the robust cost (L,) of landmarks at `points` (L, 2); the bearings as in `triangulate`."""
    predicted, _ = direction_of(points[landmark], cameras)
    return _cost(landmark, len(points), wrap_angle(direction - predicted) / sigma)


def _cost(landmark: Index, count: int, scaled: Array) -> Array:
    """Return the robust cost (L,) of residuals (K,) in sigmas."""
    return np.asarray(np.bincount(landmark, CAUCHY**2 * np.log1p((scaled / CAUCHY) ** 2), count))


def _normal(landmark: Index, count: int, residual: Array, jacobian: Array, weight: Array) -> tuple[Array, Array]:
    normal = normal_matrix(landmark, count, jacobian, weight)
    return normal, _sum_by(landmark, count, (weight * residual)[:, None] * jacobian)


def normal_matrix(landmark: Index, count: int, jacobian: Array, weight: Array) -> Array:
    """Return Σ w j jᵀ (L, 2, 2) over the bearings (K) of each landmark, j (K, 2) and w (K,)."""
    return _sum_by(landmark, count, weight[:, None, None] * jacobian[:, :, None] * jacobian[:, None, :])


def _solve(normal: Array, right: Array) -> Array:
    """Return the solutions (L, 2) of 2×2 systems; 0 where a system is singular."""
    (a, b), (_, d) = np.moveaxis(normal[:, 0], -1, 0), np.moveaxis(normal[:, 1], -1, 0)
    determinant = a * d - b**2
    safe = np.where(determinant > 1e-300, determinant, np.inf)
    x = (d * right[:, 0] - b * right[:, 1]) / safe
    z = (a * right[:, 1] - b * right[:, 0]) / safe
    return np.stack([x, z], axis=-1)


def _sum_by(group: Index, count: int, values: Array) -> Array:
    """Return the sums (L, …) of values (K, …) by group (K,)."""
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    summed = np.stack([np.bincount(group, flat[:, i], count) for i in range(flat.shape[1])], axis=-1)
    return np.asarray(summed.reshape(count, *values.shape[1:]), dtype=np.float64)


# -- tracks become landmarks ------------------------------------------------------------------------------------------

SHORTEST_TRACK = 3
_JOIN_CHI2 = 11.8  # 99.7 % of a Gaussian in the plane: three sigmas
_UNLIKE = -3.0  # log-likelihood ratio of looks below which two tracks are not one edge
_VAGUE_M = 0.5  # a place less certain than this says nothing
_ONE_SIGN = 0.6  # four of five sightings show an edge that has a polarity with that one
_ROUNDS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Built:
    """Landmarks (L) and which sightings (S) show them.

    of: (S,) landmark of each sighting, -1 for none. used: (K,) the sightings that have one. fit: of those K.
    parallax: (L,) rad. count: (L,) frames that show it. side, polarity: (L, 2), (L,) how it looks.
    """

    of: Index
    used: Index
    fit: Triangulated
    parallax: Array
    count: Index
    side: Array
    polarity: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.parallax)

    @property
    def cov(self) -> Array:
        """Covariance (L, 2, 2) m² by the spread of the bearings, never better than their stated errors allow."""
        landmark = self.of[self.used]
        excess = np.bincount(landmark, self.fit.chi2 * self.fit.weight, len(self))
        freedom = np.maximum(np.bincount(landmark, self.fit.weight, len(self)) - 2, 1)
        return self.fit.cov * np.maximum(excess / freedom, 1.0)[:, None, None]


def measured_sigma(sightings: Sightings, focal_px: float, parameters: MappingParameters) -> Array:
    """Return the sigma (S,) rad of each bearing with what does not average out."""
    return np.hypot(sightings.sigma, parameters.systematic_px / focal_px)


def join_tracks(sightings: Sightings, of: Index, cameras: Array, sigma: Array, parameters: MappingParameters) -> Built:
    """Return the landmarks that groups of sightings, `of` (S,), make when all that are one edge are joined."""
    built = fit_landmarks(sightings, renumber(of), cameras, sigma)
    for _ in range(_ROUNDS):
        number = _join(built, parameters)
        if (number == np.arange(len(built))).all():
            break
        built = fit_landmarks(sightings, renumber(np.where(built.of >= 0, number[built.of], -1)), cameras, sigma)
    return built


def long_enough(of: Index, shortest: int = SHORTEST_TRACK) -> Index:
    """Return the labels (S,) with those that occur less often than `shortest` times replaced by -1."""
    count = np.bincount(of + 1)
    return np.where(count[of + 1] >= shortest, of, -1)


def fit_landmarks(sightings: Sightings, of: Index, cameras: Array, sigma: Array) -> Built:
    """Return the landmarks that the sightings (S,) with the numbers `of` make; -1 is left out."""
    used = np.flatnonzero(of >= 0)
    landmark = of[used]
    count = int(landmark.max(initial=-1)) + 1
    seen_from = cameras[sightings.frame[used]]
    direction = wrap_angle(seen_from[:, 2] - sightings.bearing[used])
    fit = triangulate(landmark, count, seen_from, direction, sigma[used])
    good = fit.weight > 0.5
    heading, _ = direction_of(fit.points[landmark], seen_from)
    frames = np.unique(landmark[good] * sightings.frames + sightings.frame[used][good]) // max(sightings.frames, 1)
    # The sign that most show; 0 where many disagree: what lies behind the edge decides it.
    sign = sightings.polarity[used]
    signs, known = np.bincount(landmark, sign, count), np.bincount(landmark, np.abs(sign), count)
    return Built(
        of=of,
        used=used,
        fit=fit,
        parallax=_spread(landmark[good], count, heading[good]),
        count=np.bincount(frames, minlength=count),
        side=medians(landmark, count, sightings.side[used]),
        polarity=np.where(np.abs(signs) > _ONE_SIGN * known, np.sign(signs), 0).astype(np.int8),
    )


def _join(built: Built, parameters: MappingParameters) -> Index:
    """Return for each landmark (L) the number of the one that it is the same as; its own where there is none.

    Two are one when their positions differ by no more than their errors, and they look alike. Best pairs first; each
    landmark joins once a round, because joining moves it.
    """
    one, other = _near(built, parameters)
    cov, offset = built.cov, built.fit.points[one] - built.fit.points[other]
    total = cov[one] + cov[other] + parameters.plumb_sigma_m**2 * np.eye(2)
    chi2 = np.einsum("pi,pij,pj->p", offset, np.linalg.inv(total), offset)
    looks = looks_alike(built.side[one], built.polarity[one], built.side[other], built.polarity[other])
    order = np.argsort(chi2, kind="stable")
    order = order[(chi2[order] < _JOIN_CHI2) & (looks[order] > _UNLIKE)]
    number = np.arange(len(built))
    taken = np.zeros(len(built), dtype=bool)
    for i, j in zip(one[order], other[order], strict=True):
        if not (taken[i] or taken[j]):
            taken[i] = taken[j] = True
            number[j] = i
    return number


def _near(built: Built, parameters: MappingParameters) -> tuple[Index, Index]:
    """Return the pairs of landmarks that may be one by their place; one of a pair at least must be well known.

    The error of a track of little parallax reaches over half the building: it would join anything.
    """
    from scipy.spatial import cKDTree

    sigma = np.sqrt(np.linalg.eigvalsh(built.cov)[:, 1]) + parameters.plumb_sigma_m
    certain = np.flatnonzero(sigma < _VAGUE_M)
    points, sigma = built.fit.points[certain], sigma[certain]
    known = built.parallax[certain] >= np.deg2rad(parameters.parallax_min_deg) / 2
    # Two that are near are found around the vaguer of them.
    around = cKDTree(points).query_ball_point(points, 2 * np.sqrt(_JOIN_CHI2) * sigma) if len(points) else []
    vaguer = np.repeat(np.arange(len(points)), [len(x) for x in around])
    other = np.array([index for x in around for index in x], dtype=np.int64)
    apart = np.hypot(*(points[vaguer] - points[other]).T)
    near = (apart < np.sqrt(_JOIN_CHI2) * (sigma[vaguer] + sigma[other])) & (known[vaguer] | known[other])
    pairs = np.sort(np.stack([vaguer, other])[:, near & (vaguer != other)], axis=0)
    one, other = np.unique(pairs, axis=1)
    return certain[one], certain[other]


def renumber(of: Index) -> Index:
    """Return the labels (S,) renumbered without gaps, -1 kept."""
    labels, number = np.unique(of, return_inverse=True)
    return number - 1 if labels[0] == -1 else number


def same_groups(one: Index, other: Index) -> bool:
    """Return whether two labellings (S,) put the same things together, whatever the labels; -1 is no label."""
    pairs = np.unique(np.stack([one, other]), axis=1)
    nothing = (pairs == -1).any(axis=0) & (pairs[0] != pairs[1])
    return not nothing.any() and all(len(np.unique(labels)) == len(labels) for labels in pairs)


def _spread(group: Index, count: int, heading: Array) -> Array:
    """Return the widest angle (L,) rad between the headings (K,) of each group."""
    x, y = (np.bincount(group, part, count) for part in (np.cos(heading), np.sin(heading)))
    turned = wrap_angle(heading - np.arctan2(y, x)[group])
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, group, turned)
    np.maximum.at(high, group, turned)
    return np.where(np.isfinite(low), high - low, 0.0)


def medians(group: Index, count: int, values: Array) -> Array:
    """Return the lower medians (L, C) of values (K, C) of each group, nan for none."""
    size = np.bincount(group, minlength=count)
    middle = np.cumsum(size) - size + np.maximum(size - 1, 0) // 2
    result = np.full((count, values.shape[1]), np.nan)
    for column in range(values.shape[1]):
        ordered = values[np.lexsort((values[:, column], group)), column]
        result[size > 0, column] = ordered[middle[size > 0]]
    return result
