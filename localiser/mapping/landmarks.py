"""Turn tracks into landmarks: triangulate them, join those of one edge, until nothing changes.

Whole tracks are associated, because a single edge often matches some landmark by chance. A sequence of edges with
directions that change as those of one point does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, wrap_angle
from localiser.mapping.association import looks_alike
from localiser.mapping.parameters import MappingParameters
from localiser.mapping.sightings import Index, Sightings, direction_of
from localiser.mapping.triangulate import Triangulated, triangulate

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
    return Built(
        of=of,
        used=used,
        fit=fit,
        parallax=_spread(landmark[good], count, heading[good]),
        count=np.bincount(frames, minlength=count),
        side=medians(landmark, count, sightings.side[used]),
        polarity=_common_sign(landmark, count, sightings.polarity[used]),
    )


def _join(built: Built, parameters: MappingParameters) -> Index:
    """Return for each landmark (L) the number of the one that it is the same as; its own where there is none.

    Two are one when their positions differ by no more than their errors, and they look alike. Best pairs first; each
    landmark joins once a round, because joining moves it.
    """
    one, other = _near(built, parameters)
    chi2 = _distance2(built, one, other, parameters)
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


def _distance2(built: Built, one: Index, other: Index, parameters: MappingParameters) -> Array:
    """Return the squared Mahalanobis distances (P,) between pairs of landmarks."""
    cov = built.cov
    total = cov[one] + cov[other] + parameters.plumb_sigma_m**2 * np.eye(2)
    offset = built.fit.points[one] - built.fit.points[other]
    return np.asarray(np.einsum("pi,pij,pj->p", offset, np.linalg.inv(total), offset))


def renumber(of: Index) -> Index:
    """Return the labels (S,) renumbered without gaps, -1 kept."""
    labels, number = np.unique(of, return_inverse=True)
    return number - 1 if labels[0] == -1 else number


def same_groups(one: Index, other: Index) -> bool:
    """Return whether two labellings (S,) put the same things together, whatever the labels; -1 is no label."""
    pairs = np.unique(np.stack([one, other]), axis=1)
    nothing = (pairs == -1).any(axis=0) & (pairs[0] != pairs[1])
    return not nothing.any() and all(len(np.unique(labels)) == len(labels) for labels in pairs)


def _common_sign(group: Index, count: int, sign: NDArray[np.int8]) -> NDArray[np.int8]:
    """Return the sign (L,) of most of each group (K,); 0 where many disagree: what lies behind the edge decides it."""
    total, known = np.bincount(group, sign, count), np.bincount(group, np.abs(sign), count)
    return np.where(np.abs(total) > _ONE_SIGN * known, np.sign(total), 0).astype(np.int8)


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
