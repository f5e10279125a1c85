"""The limit of accuracy: posterior Cramér-Rao bound of bearing-only localisation.

No filter's mean squared error can stay below it, whatever its number of particles. It needs the truth: poses,
associations and sigmas. [Tichavský, Muravchik, Nehorai 1998], design equation 12: I' = (Q + F I⁻¹ Fᵀ)⁻¹ + Σ HᵀH/σ².
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.landmarks import bearing_jacobian


def information(
    jacobian: Array, sigma: Array, common_jacobian: Array | None = None, common_cov: ArrayLike = 0
) -> Array:
    """Return Hᵀ R⁻¹ H (D, D) of measurements with Jacobian H (E, D) and independent sigma (E,).

    An error that all share (tilt, roll) with Jacobian G (E, K) and covariance C (K, K) makes R = diag(σ²) + G C Gᵀ.
    """
    noise = np.diag(np.square(sigma))
    if common_jacobian is not None:
        noise = noise + common_jacobian @ np.asarray(common_cov) @ common_jacobian.T
    result = jacobian.T @ np.linalg.solve(noise, jacobian)
    return np.asarray((result + result.T) / 2)


def bearing_information(
    pose: Array, camera: Camera, points: Array, edges: Edges, observation: str, *, common: bool = False
) -> Array:
    """Return the information (3, 3) that the edges of one image hold on the true pose (3,).

    points: (L, 2) of the map, which `edges.landmark_id` indexes; edges of no landmark, or of no sigma, tell nothing.
    observation: "slope" (sigma of the lean times J, design equation 7) or "line". common: count the errors that all
    edges share; leave it out where tilt and roll are exact. Raises ValueError for another observation.
    """
    sigma_of = {"slope": edges.lean_sigma, "line": edges.bearing_sigma}
    if observation not in sigma_of:
        raise ValueError(f"observation: expected slope or line, found {observation}")
    edges = edges.take((edges.landmark_id >= 0) & np.isfinite(sigma_of[observation]))
    seen = points[edges.landmark_id]
    camera = camera.at(edges.mount)
    camera_pose = camera.pose_in_map(pose)
    if observation == "slope":
        bearing = geometry.bearing_from_point(*np.moveaxis(geometry.robot_from_map(camera_pose, seen), -1, 0))
        sigma = edges.lean_sigma * geometry.bearing_per_lean(bearing, camera.mount.tilt_rad)
        common_jacobian = edges.common.bearing_from_lean
    else:
        sigma, common_jacobian = edges.bearing_sigma, edges.common.bearing_from_line
    jacobian = bearing_jacobian(pose, camera_pose, seen)
    return information(jacobian, sigma, common_jacobian if common else None, edges.common.cov)


def posterior_bound(prior_cov: Array, transition: Array, noise: Array, informations: Array) -> Array:
    """Return the bound (T, D, D) on the covariance of the estimate at T images, each with its own image used.

    prior_cov: (D, D) before the first image. transition: (T-1, D, D) F and noise: (T-1, D, D) Q from each image to the
    next (`motion.linearised` at the true poses). informations: (T, D, D) of each image. All of them may be singular.
    """
    bound = np.empty_like(np.asarray(informations, dtype=np.float64))
    predicted = np.asarray(prior_cov, dtype=np.float64)
    for t, gained in enumerate(informations):
        if t > 0:
            predicted = transition[t - 1] @ bound[t - 1] @ transition[t - 1].T + noise[t - 1]
        bound[t] = _informed(predicted, gained)
    return bound


def position_bound(bound: Array) -> Array:
    """Return the bound (T,) on the RMS position error: square root of the trace of the (x, z) block of (T, 3, 3)."""
    return np.asarray(np.sqrt(np.trace(bound[:, :2, :2], axis1=1, axis2=2)))


def rms_position(bound: Array) -> float:
    """Return the RMS over T images of `position_bound`: what a whole run's position RMSE compares with."""
    return float(np.sqrt(np.square(position_bound(bound)).mean()))


def _informed(cov: Array, gained: Array) -> Array:
    # (P⁻¹ + J)⁻¹ = S (1 + Sᵀ J S)⁻¹ Sᵀ with P = S Sᵀ: never inverts P, which is singular where the motion has no noise
    # in some direction, and stays symmetric and positive.
    variance, axes = np.linalg.eigh((cov + cov.T) / 2)
    root = axes * np.sqrt(np.maximum(variance, 0.0))
    inner = np.eye(len(cov)) + root.T @ gained @ root
    result = root @ np.linalg.solve(inner, root.T)
    return np.asarray((result + result.T) / 2)
