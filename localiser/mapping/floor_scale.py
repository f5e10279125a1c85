"""The scale of a map from where edges touch the floor. Bearings alone do not determine the scale.

A camera of known height sees the foot of an edge on the floor at an angle that gives its distance. If an edge ends
above the floor (on a skirting board, on a table), or its foot is hidden, the foot appears to be farther away than it
is. It never appears nearer. So the ratios of apparent to current distance have a sharp lower limit, which is the scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.mapping.sightings import Index, Sightings, direction_of

_FARTHEST_M = 6.0  # beyond, two pixels are a tenth of the distance
_FEWEST_FEET, _FEWEST_SIGHTINGS = 5, 3
_FOOT_SIGMA = 0.012  # of the logarithm of a landmark's ratio: floors are not plane, feet not sharp
_STANDING = (0.1, 0.3, 0.5, 0.7, 0.9)  # share of feet on the floor: each as likely as the others
_FEWEST_STANDING = 0.3  # share of feet that must agree on where the floor is
_WRONG = 0.1  # share of ratios that may be anything; the rest is above the floor
_HIGHEST = 0.4  # logarithm of the ratio of what ends at a third of the camera's height
_ANYTHING = 2.0  # span of the logarithm of wrong ratios
_LEAST_SIGMA = 0.005  # the camera's stated height and tilt are no better known


@dataclass(frozen=True, slots=True)
class Scale:
    """The logarithm of true over present distances, and its sigma; infinite where no foot tells."""

    log: float
    sigma: float


def scale_by_floor_contacts(sightings: Sightings, of: Index, points: Array, cameras: Array, prior: Scale) -> Scale:
    """Return by what factor all distances should grow; `of` (S,) says which landmark (L, 2) a sighting shows.

    prior: the same factor by what is known without feet. The mixture of the module's text over the median ratios of
    the landmarks.
    """
    ratio = _ratios(sightings, of, points, cameras)
    if len(ratio) < _FEWEST_FEET:
        return Scale(0.0, np.inf)
    grid = prior.log + prior.sigma * np.linspace(-3.0, 3.0, 801)
    above = ratio[None] - grid[:, None]
    on_floor = np.exp(-0.5 * (above / _FOOT_SIGMA) ** 2) / (_FOOT_SIGMA * np.sqrt(2 * np.pi))
    higher = ((above > 0) & (above < _HIGHEST)) / _HIGHEST
    right = [share * on_floor + (1 - share) * higher for share in _STANDING]
    by_share = [np.log((1 - _WRONG) * density + _WRONG / _ANYTHING).sum(axis=1) for density in right]
    score = np.logaddexp.reduce(by_share) - 0.5 * ((grid - prior.log) / prior.sigma) ** 2
    posterior = np.exp(score - score.max())
    posterior /= posterior.sum()
    mean = float(posterior @ grid)
    if (np.abs(ratio - mean) < 2 * _FOOT_SIGMA).mean() < _FEWEST_STANDING:
        return Scale(0.0, np.inf)  # skirting boards, tables: what looks like the floor may be anything
    return Scale(mean, float(np.hypot(np.sqrt(posterior @ (grid - mean) ** 2), _LEAST_SIGMA)))


def _ratios(sightings: Sightings, of: Index, points: Array, cameras: Array) -> Array:
    """Return the logarithms of apparent over present distance, the median of each landmark with feet that agree."""
    seen: NDArray[np.int64] = np.flatnonzero((of >= 0) & (sightings.foot_m < _FARTHEST_M))
    landmark = of[seen]
    _, range_m = direction_of(points[landmark], cameras[sightings.frame[seen]])
    apparent = np.log(sightings.foot_m[seen] / np.maximum(range_m, 1e-3))
    order = np.argsort(landmark, kind="stable")
    ratios = []
    for index in np.split(order, np.flatnonzero(np.diff(landmark[order])) + 1):
        if len(index) < _FEWEST_SIGHTINGS:
            continue
        middle = float(np.median(apparent[index]))
        if np.median(np.abs(apparent[index] - middle)) < 2 * _FOOT_SIGMA:
            ratios.append(middle)
    return np.array(ratios)
