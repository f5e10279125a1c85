"""The likelihood of edges with arrays over all pairs of edge and landmark, to check the compiled loops by."""

import numpy as np

from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.observation import INLIER_RATES, EdgeObservation, Sighting
from localiser.observation.association import agreement, camera_poses, expected_from, normal
from localiser.particles import Particles


def by_rate_plain(
    observation: EdgeObservation,
    particles: Particles,
    sighting: Sighting,
    landmark_map: LandmarkMap,
    blur_rad: float = 0.0,
) -> Array:
    """Return what `EdgeObservation.by_rate` does, (K, N)."""
    count, edges = len(particles), sighting.edges
    if len(edges) == 0:
        return np.zeros((len(INLIER_RATES), count))
    frame = observation.frame(edges)
    expected = expected_from(frame, camera_poses(frame.camera, particles), landmark_map, sighting.map_scale)
    measured, measured_var = frame.measured
    measured_var = measured_var + blur_rad**2
    apart, variance = measured - expected.angle[:, None], measured_var + expected.variance[:, None]
    pair, edge = np.nonzero(apart**2 < 36.0 * variance)
    density = normal(apart[pair, edge], variance[pair, edge])
    density *= agreement(frame, expected, pair, edge)
    if sighting.persistent is not None:
        density /= sighting.persistent[edge]
    total = np.bincount(expected.pose[pair] * len(edges) + edge, density, minlength=count * len(edges))
    # A particle that sees no landmark can explain no edge: its densities are zero, all edges are clutter.
    visible = np.maximum(np.bincount(expected.pose, expected.in_the_open, minlength=count), 1)
    ratio = total.reshape(count, len(edges)) * (frame.span_rad / visible)[:, None]
    return np.stack([np.log1p(rate * (ratio - 1.0)).sum(axis=1) for rate in INLIER_RATES])
