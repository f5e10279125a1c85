"""Where an edge ends in the image says which landmark it can be."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Array, lean_from_bearing
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation, ObservationParameters
from localiser.particles import POSE, Particles

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.deg2rad(20.0), 0.8))
POSES = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.02]])
JAMB = np.array([[0.3, -3.0]])


def edge_between(bottom_m: float, top_m: float, *, ends: bool = True) -> Edges:
    """Return the edge that the first pose sees at the landmark's bearing, between two heights."""
    points = np.array([[JAMB[0, 0], height, JAMB[0, 1]] for height in (bottom_m, top_m)])
    ends_px = CAMERA.project(POSES[0], points)[None] if ends else np.full((1, 2, 2), np.nan)
    bearing = np.arctan2(JAMB[:, 0], -JAMB[:, 1])
    sigma = np.array([0.002])
    return Edges.from_columns(bearing, sigma, lean_from_bearing(bearing, CAMERA.mount.tilt_rad), sigma, ends_px=ends_px)


def gain(edges: Edges, bottom_m: float, top_m: float, kind: str = "line") -> float:
    """Return how much likelier the true pose is than one turned by 1.1°, as a log ratio."""
    landmark_map = LandmarkMap.from_points(JAMB, bottom_m=np.array([bottom_m]), top_m=np.array([top_m]))
    observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind))  # type: ignore[arg-type]
    particles = Particles(POSE, POSES.T.copy(), np.zeros(2))
    found: Array = observation.log_likelihood(particles, edges, landmark_map)
    return float(found[0] - found[1])


def test_ends_that_are_not_known_tell_nothing() -> None:
    known = gain(edge_between(0.2, 0.6), np.nan, np.nan)
    assert known > 1.0
    assert known == pytest.approx(gain(edge_between(0.2, 0.6, ends=False), 0.0, 0.9))


def test_an_edge_that_ends_where_its_landmark_does_tells_more() -> None:
    """An edge may end early, but one that reaches both ends is hardly clutter."""
    neither, foot, both = (gain(edge_between(*ends), 0.0, 0.6) for ends in ((0.2, 0.4), (0.0, 0.4), (0.0, 0.6)))
    assert 1.0 < neither < gain(edge_between(0.2, 0.4), np.nan, np.nan) < foot < both


def test_the_foot_tells_the_range() -> None:
    """Half a metre back on the line of sight the bearing is the same, the foot is not."""
    poses = np.array([[0.0, 0.0, 0.0], [-0.05, 0.5, 0.0]])
    edges = edge_between(0.0, 0.6)
    observation = EdgeObservation(CAMERA, ObservationParameters())
    for bottom_m, top_m, told in ((0.0, 0.6, True), (np.nan, np.nan, False)):
        landmark_map = LandmarkMap.from_points(JAMB, bottom_m=np.array([bottom_m]), top_m=np.array([top_m]))
        found = observation.log_likelihood(Particles(POSE, poses.T.copy(), np.zeros(2)), edges, landmark_map)
        assert (found[0] - found[1] > 1.5) == told


def test_an_edge_beyond_the_ends_of_a_landmark_is_not_its_edge() -> None:
    assert gain(edge_between(0.6, 0.8), 0.0, 0.4) == pytest.approx(0.0, abs=1e-9)


def test_an_edge_that_sticks_out_counts_less_the_more_it_does() -> None:
    gains = [gain(edge_between(0.0, top), 0.0, 0.4) for top in (0.3, 0.5, 0.7, 0.9)]
    assert gains == sorted(gains, reverse=True)
    assert gains[0] > gains[1] > gains[-1] > 0


@pytest.mark.parametrize("kind", ["line", "slope"])
def test_an_edge_of_which_nothing_is_known_says_nothing_of_the_others(kind: str) -> None:
    alone = edge_between(0.2, 0.6)
    unknown = np.array([np.nan])
    both = Edges.from_columns(
        np.concatenate([alone.bearing, unknown]),
        np.concatenate([alone.bearing_sigma, unknown]),
        np.concatenate([alone.lean, unknown]),
        np.concatenate([alone.lean_sigma, unknown]),
    )
    # The unknown edge is as good as clutter: it can only make clutter likelier, the same for both poses.
    told = gain(alone, np.nan, np.nan, kind)
    assert 0.3 * told < gain(both, np.nan, np.nan, kind) <= told
