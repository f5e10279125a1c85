"""The observation of edges with a known landmark: barcodes, simulated edges, benchmarks.

An edge belongs to its stated landmark, or it is clutter where the identity was read wrongly:

    p(q_e | pose, w) = (1 - w) / span + w N(q_e; q_l(e)(pose), σ_el²)

Edges that are known to belong to no landmark give no information.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, in_camera
from localiser.observation.edge_observation import EdgeObservation
from localiser.observation.inlier_rate import INLIER_RATES
from localiser.observation.parameters import ObservationParameters
from localiser.observation.protocols import Matches, Sighting, Targets
from localiser.particles import POSE, Particles


@dataclass(frozen=True, eq=False)
class IdentifiedObservation(EdgeObservation):
    """The observation of edges that trusts their `landmark_id`."""

    def by_rate(
        self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap, blur_rad: float = 0.0
    ) -> Array:
        """Return log p(edges | particle, w_k) (K, N) for every inlier rate, relative to all edges being clutter."""
        self = self.at(sighting.edges)  # noqa: PLW0642
        residual, variance = self._residuals(particles, sighting.edges, landmark_map, sighting.map_scale)
        variance = variance + blur_rad**2
        density = np.exp(-0.5 * residual**2 / variance) / np.sqrt(2 * np.pi * variance)
        ratio = np.where(np.isfinite(density), density, 0.0) * self.angle.span_rad
        return np.stack([np.log1p(rate * (ratio - 1.0)).sum(axis=1) for rate in INLIER_RATES])

    def by_map_scale(self, pose: Array, sighting: Sighting, landmark_map: LandmarkMap, scales: Array) -> Array:
        """Return (K,) that no scale of the map's sigmas is likelier than another: they are taken as stated."""
        return np.zeros(len(scales))

    def targets(
        self, particles: Particles, sighting: Sighting, landmark_map: LandmarkMap, inlier_rate: float
    ) -> Targets:
        """Return the edges that are said to belong to a landmark."""
        self = self.at(sighting.edges)  # noqa: PLW0642
        edges = sighting.edges.take(sighting.edges.landmark_id >= 0)
        variance = np.nanmedian(self._residuals(particles, edges, landmark_map, sighting.map_scale)[1], axis=0)
        measured = self.angle.measured(edges)[0]
        known = np.isfinite(variance) & np.isfinite(measured)
        points = landmark_map.points[edges.landmark_id[known]]
        return Targets(points, measured[known], variance[known], self.parameters.kind == "slope")

    def associate(self, pose: Array, sighting: Sighting, landmark_map: LandmarkMap) -> Matches:
        """Return the landmark that each edge is said to belong to."""
        visible = EdgeObservation.associate(self, pose, sighting, landmark_map).visible
        landmark = sighting.edges.landmark_id
        residual, sigma = np.full((2, len(landmark)), np.nan)
        one = Particles(POSE, np.asarray(pose, dtype=np.float64)[:, None], np.zeros(1))
        self = self.at(sighting.edges)  # noqa: PLW0642
        residuals, variance = self._residuals(one, sighting.edges, landmark_map, sighting.map_scale)
        residual[landmark >= 0], sigma[landmark >= 0] = residuals[0], np.sqrt(variance[0])
        return Matches(landmark, residual, visible, sigma, np.where(landmark >= 0, np.inf, np.nan))

    def _residuals(
        self, particles: Particles, edges: Edges, landmark_map: LandmarkMap, map_scale: float
    ) -> tuple[Array, Array]:
        """Return measured minus predicted angle and its variance (N, I), of the I edges of a known landmark.

        nan for a landmark behind the camera, where it cannot have been seen.
        """
        edges = edges.take(edges.landmark_id >= 0)
        measured, measured_var = self.angle.measured(edges)
        right, ahead = in_camera(self.camera_poses(particles), landmark_map.points[edges.landmark_id])
        predicted, per_bearing = self.angle.predicted(right / np.where(ahead > 0, ahead, np.nan))
        sigma_m = map_scale * landmark_map.sigma_m(self.parameters.landmark_sigma_m)[edges.landmark_id]
        position_sigma = per_bearing * sigma_m / np.hypot(right, ahead)
        return measured - predicted, measured_var + position_sigma**2


OBSERVATIONS: dict[str, type[EdgeObservation]] = {"unknown": EdgeObservation, "known": IdentifiedObservation}
"""The class of observation for each value of `observation.association`."""


def observation_of(camera: Camera, parameters: ObservationParameters) -> EdgeObservation:
    """Return the observation by one camera that the parameters ask for."""
    return OBSERVATIONS[parameters.association](camera, parameters)
