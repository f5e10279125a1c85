"""How well edges fit a pose when it is known which landmark each belongs to: barcodes, simulated edges, benchmarks.

An edge is of its landmark, or clutter where what told it apart misread:

    p(q_e | pose, w) = (1 - w) / span + w N(q_e; q_l(e)(pose), σ_el²)

Edges known to be of no landmark tell nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation, Matches, ObservationParameters, Targets
from localiser.observation.inlier_rate import INLIER_SHARES
from localiser.particles import POSE, Particles


def observation_of(camera: Camera, parameters: ObservationParameters) -> EdgeObservation:
    """Return the observation by one camera, of edges that say which landmark they belong to or that do not."""
    kind = IdentifiedObservation if parameters.association == "known" else EdgeObservation
    return kind(camera, parameters)


@dataclass(frozen=True, slots=True, eq=False)
class IdentifiedObservation(EdgeObservation):
    """The observation of edges whose `landmark_id` is believed."""

    def by_share(self, particles: Particles, edges: Edges, landmark_map: LandmarkMap, blur_rad: float = 0.0) -> Array:
        """Return log p(edges | particle, w_k) (K, N) for every inlier share, relative to all edges being clutter."""
        residual, variance = self._residuals(particles, edges, landmark_map)
        variance = variance + blur_rad**2
        density = np.exp(-0.5 * residual**2 / variance) / np.sqrt(2 * np.pi * variance)
        ratio = np.where(np.isfinite(density), density, 0.0) * self.angle.span_rad
        return np.stack([np.log1p(share * (ratio - 1.0)).sum(axis=1) for share in INLIER_SHARES])

    def targets(self, particles: Particles, edges: Edges, landmark_map: LandmarkMap, inlier_share: float) -> Targets:
        """Return the edges that are said to belong to a landmark."""
        edges = edges.take(edges.landmark_id >= 0)
        variance = np.nanmedian(self._residuals(particles, edges, landmark_map)[1], axis=0)
        measured = self.angle.measured(edges)[0]
        known = np.isfinite(variance) & np.isfinite(measured)
        return Targets(
            points=landmark_map.points[edges.landmark_id[known]],
            angle=measured[known],
            variance=variance[known],
            is_slope=self.parameters.kind == "slope",
        )

    def associate(self, pose: Array, edges: Edges, landmark_map: LandmarkMap) -> Matches:
        """Return the landmark that each edge is said to belong to."""
        visible = EdgeObservation.associate(self, pose, edges, landmark_map).visible
        identified = edges.landmark_id >= 0
        residual = np.full(len(edges), np.nan)
        one = Particles(POSE, np.asarray(pose, dtype=np.float64)[:, None], np.zeros(1))
        residual[identified] = self._residuals(one, edges, landmark_map)[0][0]
        return Matches(edges.landmark_id, residual, visible)

    def _residuals(self, particles: Particles, edges: Edges, landmark_map: LandmarkMap) -> tuple[Array, Array]:
        """Return measured minus predicted angle and its variance (N, I), of the I edges of a known landmark.

        nan for a landmark behind the camera, where it cannot have been seen.
        """
        edges = edges.take(edges.landmark_id >= 0)
        measured, measured_var = self.angle.measured(edges)
        camera_poses = self.camera_poses(particles)[:, None, :]
        x, z = np.moveaxis(geometry.robot_from_map(camera_poses, landmark_map.points[edges.landmark_id]), -1, 0)
        predicted, per_bearing = self.angle.predicted(x / np.where(z < 0, -z, np.nan))
        position_sigma = per_bearing * self._landmark_sigma(landmark_map)[edges.landmark_id] / np.hypot(x, z)
        return measured - predicted, measured_var + position_sigma**2
