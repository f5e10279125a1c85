"""Loop closure: which landmarks, built from tracks at different times, are one.

Where two landmarks are believed to be is uncertain by the drift of the robot between, but most of that is common to all
landmarks seen at the same time. The joint covariance of the smoother knows it: the distance of a pair is measured in
sigmas of their difference. Pairs whose difference is best known go first; each closure makes the others more certain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.mapping.landmarks import Built
from localiser.mapping.likeness import log_likeness
from localiser.mapping.sightings import Index

_GATE = 11.8  # 99.7 % of a Gaussian in the plane
_LEAST_SIGMA_M = 0.004  # no two sightings of one edge stand closer
_FARTHEST_SIGMA_M = 0.25  # a difference less certain than this joins anything
_UNLIKE = 0.0  # log-likelihood ratio of looks below which two are not one
_AMBIGUOUS = 2.0  # a rival this little worse (log-likelihood) forbids a choice


def same_landmarks(points: Array, joint_cov: Array, built: Built, seen: NDArray[np.bool_]) -> Index:
    """Return for each landmark (L) the number of the one that it is the same as; its own where there is none.

    points: (L, 2), joint_cov: (2L, 2L) as smoothed. built: how they look. seen: (T, L) in which frames each is seen;
    two that are often seen in one frame are two.
    """
    count = len(points)
    known = np.flatnonzero(built.parallax >= np.deg2rad(3.0))
    one, other = (known[index] for index in np.triu_indices(len(known), k=1))
    apart = points[one] - points[other]
    near = np.hypot(apart[:, 0], apart[:, 1]) < np.sqrt(_GATE) * _FARTHEST_SIGMA_M
    together = (seen.T.astype(np.int32) @ seen.astype(np.int32))[one, other]
    near &= together <= 1
    one, other, apart = one[near], other[near], apart[near]
    cov = _difference_cov(joint_cov, one, other)
    chi2 = np.einsum("pi,pij,pj->p", apart, np.linalg.inv(cov), apart)
    sigma = np.sqrt(np.linalg.eigvalsh(cov)[:, 1])
    looks = log_likeness(built.side, built.polarity, built.side, built.polarity)[one, other]
    fit = (chi2 < _GATE) & (sigma < _FARTHEST_SIGMA_M) & (looks >= _UNLIKE)
    one, other, chi2, sigma, looks = one[fit], other[fit], chi2[fit], sigma[fit], looks[fit]
    # How much likelier it is that they are one than that the second is any other edge that happens to stand here.
    score = looks - 0.5 * chi2 - np.log(sigma)
    clear = _clear(one, other, score, count)
    one, other, sigma = one[clear], other[clear], sigma[clear]
    number = np.arange(count)
    taken = np.zeros(count, dtype=bool)
    for index in np.argsort(sigma, kind="stable"):
        i, j = one[index], other[index]
        if not (taken[i] or taken[j]):
            taken[i] = taken[j] = True
            number[j] = i
    return number


def _difference_cov(joint: Array, one: Index, other: Index) -> Array:
    """Return the covariances (P, 2, 2) of the differences of pairs."""

    def block(a: Index, b: Index) -> Array:
        rows, columns = (2 * x[:, None] + np.arange(2) for x in (a, b))
        return np.asarray(joint[rows[:, :, None], columns[:, None, :]])

    cross = block(one, other)
    cov = block(one, one) + block(other, other) - cross - cross.transpose(0, 2, 1)
    return np.asarray(cov + _LEAST_SIGMA_M**2 * np.eye(2))


def _clear(one: Index, other: Index, score: Array, count: int) -> NDArray[np.bool_]:
    """Return which pairs (P,) have no rival: no other pair of either landmark is nearly as likely."""
    best, second = np.full(count, -np.inf), np.full(count, -np.inf)
    for landmark in (one, other):
        for index, value in zip(landmark, score, strict=True):
            if value > best[index]:
                best[index], second[index] = value, best[index]
            elif value > second[index]:
                second[index] = value
    unrivalled = score - _AMBIGUOUS
    is_best = (score >= best[one]) & (score >= best[other])
    return np.asarray(is_best & (second[one] < unrivalled) & (second[other] < unrivalled))
