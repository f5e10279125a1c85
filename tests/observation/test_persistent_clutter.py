"""Clutter that lasts: against simulated things on no map, and in a filter that follows another robot."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from passed_points import SIGMA as POINT_SIGMA
from passed_points import TURN_SIGMA, PassedPoints

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.filter import mcl
from localiser.geometry import Array, Increment, compose, map_from_robot, robot_from_map
from localiser.landmarks import LandmarkMap, SightParameters, field_of_view_rad
from localiser.observation import EdgeObservation, Frame, ObservationParameters, Sighting
from localiser.observation.clutter import NEAREST_M, EarlierFrame, persistent_clutter
from localiser.particles import POSE, Particles

CAMERA = Camera(640, 480, 500.0, 500.0, 319.5, 239.5, Mount(np.radians(15.0), 1.0))
SPAN = field_of_view_rad(CAMERA)


def clutter_density(
    now: ArrayLike,
    sigma: float,
    before: ArrayLike,
    motion: ArrayLike = (0, 0, 0),
    turn_var: float = 0.0,
    clutter: Array | None = None,
) -> Array:
    """Return the density at bearings, after an image with bearings `before`, all with one sigma."""
    after, earlier = (
        Frame(Edges.from_columns(*np.broadcast_arrays(np.array(one, dtype=float), sigma, np.nan, sigma)), CAMERA)
        for one in (now, before)
    )
    return persistent_clutter(after, EarlierFrame(earlier, np.array(motion, dtype=float), turn_var), clutter)


def test_nothing_is_known_without_a_last_image() -> None:
    assert clutter_density([0.1], 0.1, []).tolist() == [1.0]
    assert clutter_density([], 0.1, [0.1]).tolist() == []


def test_what_stands_where_it_was_is_as_dense_as_the_sigmas_say() -> None:
    bearing = np.array([0.2, -0.3])
    found = clutter_density(bearing + 0.05, 0.01, bearing, (0, 0, 0.05))
    np.testing.assert_allclose(found, SPAN / np.sqrt(2 * np.pi * 2e-4))


def test_what_was_a_landmark_is_not_where_clutter_is_denser() -> None:
    bearing, peak = np.array([0.2, -0.3, 0.4]), SPAN / np.sqrt(2 * np.pi * 2e-4)
    found = clutter_density(bearing, 0.01, bearing, clutter=np.array([1.0, 0.5, 0.0]))
    np.testing.assert_allclose(found, [peak, 0.5 * peak + 0.5, 1.0])


def test_of_two_that_may_continue_one_nothing_is_known() -> None:
    assert clutter_density([0.2, 0.205], 0.01, [0.2]).tolist() == [1.0, 1.0]


@settings(max_examples=50)
@given(
    st.lists(st.floats(-0.5, 0.5), max_size=8),
    st.lists(st.floats(-0.5, 0.5), max_size=8),
    st.floats(-0.3, 0.3),
    st.floats(-0.3, 0.3),
    st.floats(-0.5, 0.5),
)
def test_clutter_is_never_rarer_than_anywhere(now, before, right, back, turn):
    found = clutter_density(now, 0.02, before, (right, back, turn), 1e-4)
    assert found.shape == (len(now),)
    assert (found >= 1.0).all()
    assert (found <= SPAN / np.sqrt(2 * np.pi * 8e-4) + 1e-9).all()


@pytest.mark.parametrize("step", [(0.0, -0.3, 0.0), (0.02, -0.2, 0.2), (0.0, 0.1, -0.3)])
def test_the_density_is_that_of_points_at_unknown_distances(step: tuple[float, float, float]) -> None:
    """Points at an even 1/r, seen before and after a step: the density is as good as their histogram, to 0.1 nats."""
    points = PassedPoints.by(step, NEAREST_M)
    log_density = np.log(
        [
            clutter_density([second], POINT_SIGMA, [first], step, TURN_SIGMA**2)[0]
            for first, second in zip(points.first[:2000], points.second[:2000], strict=True)
        ]
    )
    assert log_density.mean() > points.best(SPAN) - 0.1


SIGMA = np.radians(1.0)


def one_edge(bearing: float) -> Edges:
    angle, sigma = np.array([bearing]), np.full(1, SIGMA)
    tilted = np.sin(np.radians(15.0))
    return Edges.from_columns(angle, sigma, np.arctan(tilted * np.tan(angle)), tilted * sigma)


def arena() -> tuple[LandmarkMap, Particles]:
    """A landmark 30 m away at 8°, and two poses: one that sees it there, and one, turned by 2°, that sees it at 10°."""
    away = np.radians(8.0)
    landmark_map = LandmarkMap.from_points(30.0 * np.array([[np.sin(away), -np.cos(away)]]))
    return landmark_map, Particles(POSE, np.array([[0.0, 0.0], [0.0, 0.0], [0.0, np.radians(2.0)]]), np.zeros(2))


@pytest.mark.parametrize("kind", ["line", "slope"])
def test_to_be_seen_again_tells_less_than_to_be_seen(kind: Literal["line", "slope"]) -> None:
    landmark_map, poses = arena()
    sight = SightParameters(range_max_m=40.0)
    observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind, sight=sight))
    edges = Sighting(0, one_edge(np.radians(10.0)))
    step = Increment.from_mean([0.0, -0.1, 0.0])
    frame = observation.frame(edges.edges)
    again = replace(edges, persistent=persistent_clutter(frame, EarlierFrame.of(frame, frame, step, 1e-6)))
    new, known = (np.diff(observation.log_likelihood(poses, each, landmark_map)) for each in (edges, again))
    assert 0.0 < known < 0.5 * new


def test_by_slope_the_density_is_one_of_leans() -> None:
    frame = EdgeObservation(CAMERA, ObservationParameters(kind="slope")).frame(one_edge(0.45))
    span = 2 * np.arctan(0.639 * np.tan(CAMERA.mount.tilt_rad))
    found = persistent_clutter(frame, EarlierFrame(frame, np.zeros(3), 0.0))
    np.testing.assert_allclose(found, span / np.sqrt(4 * np.pi) / frame.edges.lean_sigma)


@pytest.mark.parametrize("step", [(0.0, -0.3, 0.0), (0.0, -0.1, 0.3)])
@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.3, -0.4, 0.0), (0.0, 0.0, np.pi / 2), (0.1, -0.2, -0.7)])
def test_it_is_the_camera_that_moves(mount: tuple[float, float, float], step: tuple[float, float, float]) -> None:
    """Wherever it is on the robot: what stands ahead of it, twice as far as things may be near, is expected there."""
    camera = CAMERA.with_mount(right_m=mount[0], back_m=mount[1], yaw_rad=mount[2])
    thing = map_from_robot(camera.robot_from_level, np.array([0.2, -2 * NEAREST_M]))
    poses = [np.zeros(3), np.asarray(step)]
    seen = [robot_from_map(compose(pose, camera.robot_from_level), thing) for pose in poses]
    before, after = (one_edge(float(np.arctan2(x, -z))) for x, z in seen)
    now = Frame(after, camera)
    (clutter,) = persistent_clutter(now, EarlierFrame.of(Frame(before, camera), now, Increment.from_mean(step), 0.0))
    right, back = robot_from_map(camera.robot_from_level, compose(step, camera.robot_from_level)[:2])
    across = float(right + back * 0.1)  # at a bearing of 0.1
    sigma = np.sqrt(2 * SIGMA**2 + across**2 / 12)
    assert clutter == pytest.approx(SPAN / np.sqrt(2 * np.pi) / sigma, rel=0.2)


@pytest.mark.parametrize(("bearings", "is_dense"), [((-0.2, -0.2), True), ((-0.2, 0.3), False), ((0.14, 0.14), False)])
def test_the_filter_knows_what_the_last_image_showed(bearings: tuple[float, float], is_dense: bool) -> None:
    """What is on no map is expected again, another thing is not, and neither is the landmark at 8°."""
    observation = EdgeObservation(CAMERA, ObservationParameters(sight=SightParameters(range_max_m=40.0)))
    filter_ = mcl.Mcl(arena()[0], observation, mcl.MclParameters(particles=50))
    state, rng, located = mcl.FilterState(), np.random.default_rng(0), []
    events: list[mcl.Event] = [mcl.Start(0, np.zeros(3), np.eye(3) * 1e-4)]
    for t, bearing in enumerate(bearings):
        events += [mcl.Odometry(t, np.array([0.0, -0.1 * t, 0.0])), mcl.Sighting(t, one_edge(bearing))]
    for event in events:
        located += list(mcl.step(filter_, state, event, rng))
    sighting = located[-1].sighting
    assert (sighting.persistent[0] > 5.0) == is_dense
    assert sighting.persistent[0] < 2.0 or is_dense
