"""The inverse-depth model of an edge: a direction from where it was first seen, and an inverse distance along it.

It is nearly linear in what a camera measures, for near and far edges and for edges of unknown distance [Civera,
Davison, Montiel 2008]. So an extended Kalman filter can follow an edge from its first sighting. This module has the
start, the prediction with its derivative, and the update of many filters at once. The map that grows while driving
passes start and prediction to filterpy.
"""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array, forward


def first_state(heading: Array, sigma: Array, nearest_m: float) -> tuple[Array, Array]:
    """Return states (K, 2) and covariances (K, 2, 2) of edges just seen, at unknown distance.

    State: heading (rad) and inverse distance (1/m), which is between 1/nearest_m and 0 within two sigmas.
    """
    inverse = np.full(len(heading), 1 / (3 * nearest_m))
    return np.stack([heading, inverse], axis=-1), np.eye(2) * np.stack([sigma, inverse], axis=-1)[:, None] ** 2


def predicted(origin: Array, state: Array, camera: Array) -> tuple[Array, Array]:
    """Return the heading (K,) under which the camera (3,) sees each edge, and its derivative by the state (K, 2).

    origin: (K, 2) where the camera was when it first saw each.
    """
    baseline = origin - camera[:2]
    ray = forward(state[:, 0]) + state[:, 1:] * baseline
    by_ray = np.stack([ray[:, 1], -ray[:, 0]], axis=-1) / np.maximum((ray**2).sum(axis=1), 1e-12)[:, None]
    turned = forward(state[:, 0] + np.pi / 2)
    jacobian = np.stack([(by_ray * turned).sum(axis=1), (by_ray * baseline).sum(axis=1)], axis=-1)
    return np.arctan2(-ray[:, 0], -ray[:, 1]), jacobian


def updated(state: Array, cov: Array, innovation: Array, jacobian: Array, sigma: Array) -> tuple[Array, Array]:
    """Return states (K, 2) and covariances (K, 2, 2) after one bearing each: the Kalman filter's update for a scalar.

    innovation: (K,) measured minus predicted heading. jacobian: (K, 2) of the prediction. sigma: (K,) of the bearing.
    """
    gain = np.einsum("kij,kj->ki", cov, jacobian)
    gain /= ((gain * jacobian).sum(axis=1) + sigma**2)[:, None]
    moved = state + gain * innovation[:, None]
    moved[:, 1] = np.maximum(moved[:, 1], 0.0)
    left = np.eye(2) - gain[:, :, None] * jacobian[:, None, :]
    # Joseph's form keeps the covariance symmetric and positive.
    return moved, left @ cov @ left.transpose(0, 2, 1) + np.einsum("ki,kj,k->kij", gain, gain, sigma**2)
