"""The motion between two frames, from edges that were simulated from the equations alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from localiser import geometry
from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Array, Increment
from localiser.increments import Gaussian, IncrementParameters, Odometer, follow
from localiser.increments.fuse import mixture
from localiser.increments.views import Sights, camera_motion, predicted

CAMERA = Camera(
    640,
    480,
    554.0,
    554.0,
    319.5,
    239.5,
    Mount(np.radians(20.0), 0.9, yaw_rad=np.radians(3.0), right_m=0.05, back_m=-0.1),
)
ANYTHING = Gaussian(np.zeros(3), IncrementParameters().motion_cov(0.2))
BEARING_SIGMA, INVERSE_SIGMA = np.radians(0.02), 0.004
POINTS = np.array(
    [
        [-1.5, -3.0],
        [-1.4, -4.5],
        [-0.8, -2.6],
        [-0.3, -6.0],
        [0.2, -3.4],
        [0.6, -5.2],
        [1.1, -2.9],
        [1.6, -4.0],
        [2.2, -4.9],
    ]
)


def edges_from(pose: Array, rng: np.random.Generator, points: Array = POINTS, feet: bool = True) -> Edges:
    """Return what a robot at `pose` sees of edges at `points` (E, 2), each with a look of its own."""
    at = geometry.robot_from_map(CAMERA.pose_in_map(pose), points)
    bearing = geometry.bearing_from_point(*at.T) + BEARING_SIGMA * rng.standard_normal(len(points))
    inverse = 1.0 / np.hypot(*at.T) + INVERSE_SIGMA * rng.standard_normal(len(points))
    unknown = np.full(len(points), np.nan)
    look = np.random.default_rng(1).uniform(0, 255, (len(POINTS) + 20, 8))[: len(points)]
    return Edges.from_columns(
        bearing,
        np.full(len(points), BEARING_SIGMA),
        unknown,
        unknown,
        polarity=np.where(np.arange(len(points)) % 2, 1, -1).astype(np.int8),
        foot_range_m=1.0 / inverse if feet else unknown,
        foot_range_sigma_m=INVERSE_SIGMA / inverse**2 if feet else unknown,
        profile=look,
    )


motions = st.tuples(st.floats(-0.05, 0.05), st.floats(-0.2, 0.1), st.floats(-0.2, 0.2)).map(np.array)


@settings(derandomize=True, max_examples=50)
@given(motions, st.floats(-0.5, 0.5), st.floats(0.0, 1.5))
def test_prediction_is_what_the_moved_camera_sees(motion: Array, bearing: float, inverse: float) -> None:
    moved, jac = camera_motion(motion, CAMERA)
    np.testing.assert_allclose(
        CAMERA.pose_in_map(motion), geometry.compose(CAMERA.pose_in_map(np.zeros(3)), moved), atol=1e-12
    )
    seen = predicted(np.array([bearing]), np.array([inverse]), moved)
    if inverse > 0.01:
        point = np.array([np.sin(bearing), -np.cos(bearing)]) / inverse
        at = geometry.robot_from_map(moved, point)
        assert seen.bearing[0] == pytest.approx(float(geometry.bearing_from_point(*at)))
        assert seen.inverse_range[0] == pytest.approx(1.0 / np.hypot(*at))
    step = 1e-6
    for column in range(3):
        change = step * np.eye(3)[column]
        ends = [camera_motion(motion + sign * change, CAMERA)[0] for sign in (1, -1)]
        np.testing.assert_allclose(jac[:, column], (ends[0] - ends[1]) / (2 * step), atol=1e-8)
        ends = [predicted(np.array([bearing]), np.array([inverse]), moved + sign * change) for sign in (1, -1)]
        for row, name in enumerate(("bearing", "inverse_range")):
            slope = (getattr(ends[0], name)[0] - getattr(ends[1], name)[0]) / (2 * step)
            assert seen.by_motion[0, row, column] == pytest.approx(slope, abs=1e-6)
    for column, change in enumerate(((step, 0.0), (0.0, step))):
        ends = [
            predicted(np.array([bearing + s * change[0]]), np.array([inverse + s * change[1]]), moved) for s in (1, -1)
        ]
        for row, name in enumerate(("bearing", "inverse_range")):
            slope = (getattr(ends[0], name)[0] - getattr(ends[1], name)[0]) / (2 * step)
            assert seen.by_edge[0, row, column] == pytest.approx(slope, abs=1e-6)


def test_turning_on_the_spot_is_equation_13_of_the_paper() -> None:
    tilt = np.radians(30.0)
    slopes = np.tan(np.radians([106.82, 95.16]))
    bearings = geometry.bearing_from_lean(geometry.lean_from_slope(slopes), tilt)
    turn = float(geometry.rotation_from_slopes(slopes[0], slopes[1], tilt))
    seen = predicted(bearings[:1], np.array([0.4]), np.array([0.0, 0.0, turn]))
    assert seen.bearing[0] == pytest.approx(bearings[1])


@pytest.mark.parametrize("motion", [[0.0, -0.1, 0.0], [0.0, 0.0, 0.15], [0.01, -0.08, -0.12], [0.0, 0.0, 0.0]])
def test_motion_is_found_with_no_idea_beforehand(motion: list[float]) -> None:
    rng = np.random.default_rng(3)
    found = follow(edges_from(np.zeros(3), rng), edges_from(np.array(motion), rng), CAMERA, ANYTHING)
    np.testing.assert_array_equal(found.first, found.second)
    assert len(found.first) >= 8
    assert (np.abs(found.mean - motion) < 5 * np.sqrt(np.diag(found.cov))).all()
    assert abs(found.mean[2] - motion[2]) < np.radians(0.1)
    assert np.sqrt(np.diag(found.cov))[:2].max() < 0.03


def test_clutter_and_edges_that_hang_in_the_air_do_not_mislead() -> None:
    rng = np.random.default_rng(4)
    motion = np.array([0.0, -0.1, 0.1])
    before, after = (edges_from(pose, rng) for pose in (np.zeros(3), motion))
    for edges in (before, after):
        edges.foot_range_m[[2, 5]] *= 1.6
    new = edges_from(motion, rng, np.array([[-2.0, -3.3], [0.9, -3.0], [0.1, -2.0]]))
    columns = ("bearing", "bearing_sigma", "lean", "lean_sigma")
    both = {name: np.concatenate([getattr(after, name), getattr(new, name)]) for name in columns}
    more = {
        name: np.concatenate([getattr(after, name), getattr(new, name)])
        for name in ("polarity", "foot_range_m", "foot_range_sigma_m", "profile")
    }
    found = follow(before, Edges.from_columns(**both, **more), CAMERA, ANYTHING)
    assert abs(found.mean[2] - motion[2]) < np.radians(0.1)
    np.testing.assert_allclose(found.mean[:2], motion[:2], atol=0.02)


def test_what_edges_do_not_tell_stays_as_uncertain_as_before() -> None:
    rng = np.random.default_rng(5)
    prior = np.sqrt(np.diag(ANYTHING.cov))
    none = follow(Edges.none(), edges_from(np.zeros(3), rng), CAMERA, ANYTHING)
    np.testing.assert_allclose(none.cov, ANYTHING.cov)
    motion = np.array([0.0, -0.1, 0.02])
    ahead = geometry.map_from_robot(CAMERA.robot_from_level, np.array([[0.0, -4.0]]))
    one = follow(edges_from(np.zeros(3), rng, ahead), edges_from(motion, rng, ahead), CAMERA, ANYTHING)
    assert (np.sqrt(np.diag(one.cov))[:2] > 0.3 * prior[:2]).all()
    blind = follow(edges_from(np.zeros(3), rng, feet=False), edges_from(motion, rng, feet=False), CAMERA, ANYTHING)
    known = follow(edges_from(np.zeros(3), rng), edges_from(motion, rng), CAMERA, ANYTHING)
    assert np.sqrt(blind.cov[1, 1]) > 5 * np.sqrt(known.cov[1, 1])


def test_what_hangs_on_a_wall_near_by_is_not_taken_for_far_edges() -> None:
    """Ends near the horizon look like feet far away, and edges as far as that would be sure of a wrong turn."""
    wall = np.array([[x_m, -1.2] for x_m in (-0.5, -0.46, -0.42, -0.05, 0.0, 0.05, 0.3)])
    seen_share = np.array([0.06, 0.03, 0.1, 0.08, 0.05, 0.02, 0.1])
    motion, misses = np.array([0.0, 0.0, np.radians(6.0)]), []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        before, after = (edges_from(pose, rng, wall) for pose in (np.zeros(3), motion))
        for edges in (before, after):
            edges.foot_range_m[:] /= seen_share
            edges.foot_range_sigma_m[:] = INVERSE_SIGMA * edges.foot_range_m**2
        found = follow(before, after, CAMERA, ANYTHING)
        assert len(found.first) >= 6
        error = found.mean - motion
        misses.append(error @ np.linalg.solve(found.cov, error))
    assert np.mean(misses) < 9.0


def test_edges_that_the_border_cuts_off_have_no_foot() -> None:
    edges = edges_from(np.zeros(3), np.random.default_rng(9))
    rows = np.linspace(300.0, 475.0, len(edges))
    edges.ends_px[:, 0] = np.stack([np.full(len(edges), 320.0), rows], axis=-1)
    np.testing.assert_array_equal(np.isnan(Sights.of(edges, CAMERA).inverse_range), rows > 471.0)
    edges.ends_px[:] = np.nan
    assert np.isfinite(Sights.of(edges, CAMERA).inverse_range).all()


def odometer(source: str) -> Odometer:
    return Odometer(CAMERA, IncrementParameters(source=source))


WHEEL_COV = np.diag([1e-4, 9e-3, np.radians(0.5)]) ** 2


def test_wheels_alone_are_passed_through() -> None:
    wheel = Increment.from_mean([0.0, -0.1, 0.1])
    assert odometer("wheel").increment(wheel, WHEEL_COV, None, Edges.none(), 0.2) is wheel
    assert odometer("both").increment(wheel, WHEEL_COV, None, Edges.none(), 0.0) is wheel


def test_both_sharpen_the_turn_of_wheels_that_hold() -> None:
    rng = np.random.default_rng(6)
    motion = np.array([0.0, -0.1, 0.1])
    wheel = Increment.from_mean([0.0, -0.096, 0.106])
    found = odometer("both").increment(wheel, WHEEL_COV, edges_from(np.zeros(3), rng), edges_from(motion, rng), 0.2)
    assert found.source == "both"
    assert abs(found.mean[2] - motion[2]) < np.radians(0.1) < abs(wheel.mean[2] - motion[2])
    assert np.sqrt(found.cov[2, 2]) < np.radians(0.25)


@pytest.mark.parametrize("slip", [[0.0, -0.1, 0.0], [0.0, 0.0, np.radians(10.0)]])
def test_both_leave_wheels_that_slip(slip: list[float]) -> None:
    rng = np.random.default_rng(7)
    motion = np.array([0.0, -0.05, 0.05])
    wheel = Increment.from_mean(motion + slip)
    found = odometer("both").increment(wheel, WHEEL_COV, edges_from(np.zeros(3), rng), edges_from(motion, rng), 0.2)
    assert np.linalg.norm(found.mean[:2] - motion[:2]) < 0.02
    assert abs(found.mean[2] - motion[2]) < np.radians(0.3)


def test_without_edges_wheels_are_believed() -> None:
    wheel = Increment.from_mean([0.0, -0.1, 0.1])
    found = odometer("both").increment(wheel, WHEEL_COV, None, Edges.none(), 0.2)
    np.testing.assert_allclose(found.mean, wheel.mean, atol=1e-3)
    assert np.sqrt(found.cov[1, 1]) < 0.012


def test_vision_that_sees_nothing_may_have_moved_anywhere() -> None:
    found = odometer("vision").increment(Increment.from_mean(np.zeros(3)), WHEEL_COV, None, Edges.none(), 0.2)
    np.testing.assert_allclose(found.cov, ANYTHING.cov)
    assert found.path_m > 0.1 and found.turned_rad > 0.1


def test_moments_of_a_mixture() -> None:
    rng = np.random.default_rng(8)
    parts = [
        Gaussian(np.array([0.0, 0.1, 3.1]), 0.01 * np.eye(3)),
        Gaussian(np.array([0.2, 0.1, -3.1]), 0.04 * np.eye(3)),
    ]
    whole = mixture(parts, np.log([0.25, 0.75]))
    chosen = rng.random(200_000) < 0.25
    draws = np.where(
        chosen[:, None],
        rng.multivariate_normal(parts[0].mean, parts[0].cov, 200_000),
        rng.multivariate_normal(parts[1].mean, parts[1].cov, 200_000),
    )
    apart = draws - whole.mean
    apart[:, 2] = geometry.wrap_angle(apart[:, 2])
    np.testing.assert_allclose(apart.mean(axis=0), 0.0, atol=3e-3)
    np.testing.assert_allclose(np.cov(apart.T), whole.cov, atol=1e-3)
