"""Errors of landmarks' places that no number of images averages out, because they change with the direction of view.

The two sides of a post, its bevel, and the blur of its shadow: from one side an edge is seen some millimetres beside
where it is seen from another side. So images from nearly one direction share an error across their line of sight. Seen
from directions that are few degrees apart, it is the distance that suffers: 3 mm more over 10° move it by 2 cm.
"""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array, wrap_angle
from localiser.mapping.landmarks import Built
from localiser.mapping.sightings import Index, Sightings, direction_of, per_point
from localiser.mapping.triangulate import inverse_information, normal_matrix

_ANOTHER_SIDE_RAD = np.pi / 4
"""The error is another one after half of a right angle: most things have four sides."""


def place_cov(sightings: Sightings, built: Built, cameras: Array, sigma: Array, place_sigma_m: float) -> Array:
    """Return the covariance (L, 2, 2) m² of the landmarks' places by errors that the images of one direction share.

    cameras: (T, 3). sigma: (S,) rad of each bearing. An edge is seen beside its place by an Ornstein-Uhlenbeck process
    of the direction of view, N(0, place_sigma_m²) across the line of sight. With the weights of `triangulate` that is
    I⁻¹ (Σ Σ u_k u_lᵀ exp(-|φ_k - φ_l| / 45°)) I⁻¹, u being the pull of one bearing whose error is place_sigma_m and I
    the information of the bearings at known poses, whatever else the landmark's covariance holds.
    """
    landmark, seen_from = built.of[built.used], cameras[sightings.frame[built.used]]
    at = built.fit.points[landmark]
    heading, range_m = direction_of(at, seen_from)
    jacobian, weight = per_point(at, seen_from), built.fit.weight / sigma[built.used] ** 2
    pull = (weight * place_sigma_m / np.maximum(range_m, 1e-6))[:, None] * jacobian
    shared = _shared(landmark, len(built), heading, pull)
    cov = inverse_information(normal_matrix(landmark, len(built), jacobian, weight))
    return cov @ shared @ cov


def _shared(landmark: Index, count: int, heading: Array, pull: Array) -> Array:
    """Return Σ Σ u_k u_lᵀ exp(-|φ_k - φ_l| / 45°) (L, 2, 2) over the pulls u (K, 2) of each landmark (K,).

    In the order of directions the exponential is a product, so that one running sum has all that came before.
    """
    x, y = (np.bincount(landmark, part, count) for part in (np.cos(heading), np.sin(heading)))
    turned = wrap_angle(heading - np.arctan2(y, x)[landmark]) / _ANOTHER_SIDE_RAD
    order = np.lexsort((turned, landmark))
    result = np.zeros((count, 2, 2))
    for own in np.split(order, np.flatnonzero(np.diff(landmark[order])) + 1):
        if len(own):
            result[landmark[own[0]]] = _shared_by_one(turned[own, None], pull[own])
    return result


def _shared_by_one(turned: Array, pull: Array) -> Array:
    """Return Σ Σ u_k u_lᵀ exp(-|t_k - t_l|) (2, 2) over the pulls u (K, 2) at ascending t (K, 1)."""
    grown = np.exp(turned) * pull
    earlier = np.exp(-turned) * (np.cumsum(grown, axis=0) - grown)
    pairs = pull.T @ earlier
    return pull.T @ pull + pairs + pairs.T
