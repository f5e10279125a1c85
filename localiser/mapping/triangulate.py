"""Landmarks from bearings at known poses: a robust least-squares problem of two unknowns for each.

Minimises Σ ρ((φ_k - direction(point - camera_k)) / σ_k) with Cauchy's ρ by damped Gauss-Newton, all landmarks at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from localiser.geometry import Array, forward, wrap_angle
from localiser.mapping.sightings import Index, direction_of, per_point

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
