"""Where an edge ends in the image says which landmark it can be."""

from dataclasses import replace

import numpy as np
import pytest

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Array, lean_from_bearing
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation, ObservationParameters, Sighting
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
    found: Array = observation.log_likelihood(particles, Sighting(0, edges), landmark_map)
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
        found = observation.log_likelihood(
            Particles(POSE, poses.T.copy(), np.zeros(2)), Sighting(0, edges), landmark_map
        )
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


def beside(edges: Edges, bottom_m: float, top_m: float, count: int = 15) -> Edges:
    """Return the edges and a row of others beside them, as far away as the landmark and between two heights."""
    bearing = np.arctan2(JAMB[0, 0], -JAMB[0, 1]) + np.deg2rad(4.0 + np.arange(count))
    range_m = np.hypot(*JAMB[0])
    points = [[[range_m * np.sin(b), height, -range_m * np.cos(b)] for height in (bottom_m, top_m)] for b in bearing]
    ends_px = np.stack([CAMERA.project(POSES[0], np.array(point)) for point in points])
    return Edges.from_columns(
        np.append(edges.bearing, bearing),
        np.full(count + 1, 0.002),
        lean_from_bearing(np.append(edges.bearing, bearing), CAMERA.mount.tilt_rad),
        np.full(count + 1, 0.002),
        ends_px=np.concatenate([edges.ends_px, ends_px]),
    )


def test_an_end_in_a_row_of_others_tells_less_than_one_that_stands_out() -> None:
    """A landmark that reaches from 0.4 to 0.6 m may as well be another book on a shelf of such books."""
    edge = edge_between(0.4, 0.6)
    in_row, alone = (gain(beside(edge, *row), 0.4, 0.6) for row in ((0.4, 0.6), (0.0, 0.2)))
    assert 0.0 < in_row < alone - 1.0


def test_an_edge_that_stops_short_tells_less_the_longer_its_landmark_and_the_fuller_its_row() -> None:
    edge = edge_between(0.4, 0.6)
    books = beside(edge, 0.4, 0.6)
    gains = [gain(books, 0.0, top) for top in (0.7, 1.0, 2.5)]
    assert gains == sorted(gains, reverse=True)
    assert gains[-1] < 0.1 * gain(edge, 0.0, 2.5)


def test_an_edge_that_the_border_of_the_image_ends_does_not_stop_short() -> None:
    """The door goes on above the image: an edge up to the border is all that can be seen of it."""
    door = edge_between(0.0, 2.0)
    assert door.ends_px[..., 1].min() < 0, "the top is beyond the border"
    up_to_border = beside(replace(door, ends_px=np.clip(door.ends_px, 0.0, [639.0, 479.0])), 0.0, 0.5)
    stops = beside(edge_between(0.0, 0.5), 0.0, 0.5)
    assert gain(up_to_border, 0.0, 2.0) == pytest.approx(gain(up_to_border, 0.0, np.nan), rel=1e-6)
    assert gain(stops, 0.0, 2.0) < gain(stops, 0.0, np.nan) - 0.5


def test_two_landmarks_beside_the_robot_do_not_explain_a_shelf() -> None:
    """So near that their bearings are known to degrees only, they fit every book, but none of them is 20 cm long."""
    books = beside(edge_between(0.4, 0.6), 0.4, 0.6)
    bearing = np.deg2rad([11.0, 18.0])
    points = 0.35 * np.column_stack([np.sin(bearing), -np.cos(bearing)])
    one = Particles(POSE, POSES[:1].T.copy(), np.zeros(1))
    observation = EdgeObservation(CAMERA, ObservationParameters())
    tall = LandmarkMap.from_points(points, bottom_m=np.zeros(2), top_m=np.full(2, 1.9))
    assert observation.log_likelihood(one, Sighting(0, books), LandmarkMap.from_points(points))[0] > 5.0
    assert observation.log_likelihood(one, Sighting(0, books), tall)[0] < 0.0
