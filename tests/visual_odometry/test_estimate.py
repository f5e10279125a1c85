"""The motion between two frames, from edges simulated from the equations alone; increments in the filter."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from short_log import CORRIDOR, Localiser, cut_log
from small_log import write_edge_log
from two_views import CAMERA, INVERSE_SIGMA, POINTS, edges_from

from localiser import geometry
from localiser.config import read_config
from localiser.edges import Edges
from localiser.errors import InputError
from localiser.filter import mcl
from localiser.geometry import Array, Increment, compose
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation, ObservationParameters
from localiser.particles import normalised
from localiser.visual_odometry import (
    Gaussian,
    Odometer,
    TwoImages,
    VisualOdometryParameters,
    follow,
    increment_of,
    mixture,
    with_scale,
)
from localiser.visual_odometry import pair_kernel as loops
from localiser.visual_odometry.two_images import TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD, SeenEdges
from paper.slopes import depth_from_slopes, lean_from_slope, rotation_from_slopes

ANYTHING = VisualOdometryParameters().expected(None, 0.2)


def followed(before: Edges, after: Edges) -> Gaussian:
    """Return the motion in 0.2 s of which nothing is known but two images."""
    return follow(TwoImages.of(before, after, CAMERA), [(ANYTHING, 0.0)])


motions = st.tuples(st.floats(-0.05, 0.05), st.floats(-0.2, 0.1), st.floats(-0.2, 0.2)).map(np.array)


@settings(max_examples=50)  # the first call compiles
@given(motions, st.floats(-0.5, 0.5), st.floats(0.0, 1.5))
def test_what_the_moved_camera_sees(motion: Array, bearing: float, inverse: float) -> None:
    seen, distance, slope = loops.seen_from(bearing, inverse, motion)
    nearer, *_ = loops.seen_from(bearing, inverse + 1e-6, motion)
    assert slope == pytest.approx((nearer - seen) / 1e-6, abs=1e-5)
    if inverse > 0.01:
        point = np.array([np.sin(bearing), -np.cos(bearing)]) / inverse
        at = geometry.robot_from_map(motion, point)
        assert seen == pytest.approx(float(np.arctan2(at[0], -at[1])))
        assert inverse / distance == pytest.approx(1.0 / np.hypot(*at))


def test_turning_on_the_spot_is_equation_13_of_the_paper() -> None:
    tilt = np.radians(30.0)
    slopes = np.tan(np.radians([106.82, 95.16]))
    bearings = geometry.bearing_from_lean(lean_from_slope(slopes), tilt)
    turn = float(rotation_from_slopes(slopes[0], slopes[1], tilt))
    assert loops.seen_from(bearings[0], 0.4, np.array([0.0, 0.0, turn]))[0] == pytest.approx(bearings[1])


def test_driving_straight_on_is_equation_10_of_the_paper() -> None:
    tilt, ahead_m, driven_m, right_m = np.radians(30.0), 3.0, 0.5, 0.8
    bearing = float(np.arctan2(right_m, ahead_m))
    seen = loops.seen_from(bearing, 1.0 / np.hypot(right_m, ahead_m), np.array([0.0, -driven_m, 0.0]))[0]
    slopes = geometry.slope_from_lean(geometry.lean_from_bearing(np.array([bearing, seen]), tilt))
    assert depth_from_slopes(*slopes, -driven_m) == pytest.approx(-ahead_m)


def test_a_turn_beyond_half_a_turn_is_compared_with_its_prior() -> None:
    """The prior is at 3.12 rad, and the robot turned by 3.15, which is -3.13."""
    rng, motion, prior = np.random.default_rng(3), np.array([0.0, -0.1, 3.15]), np.array([0.0, -0.1, 3.12])
    points = np.concatenate([POINTS, geometry.map_from_robot(motion, POINTS)])
    one, two = (edges_from(pose, rng, points) for pose in (np.zeros(3), motion))
    images = TwoImages.of(one, two, CAMERA)
    found = follow(images, [(Gaussian(prior, np.diag([0.01, 0.01, 0.01])), 0.0)])
    error = found.mean - motion
    error[2] = geometry.wrap_angle(error[2])
    assert error @ np.linalg.solve(found.cov, error) < 16.3  # chi-square of 3, 99.9 %


def normal(value: Array, mean: Array, variance: Array) -> Array:
    return np.asarray(np.exp(-0.5 * (value - mean) ** 2 / variance) / np.sqrt(2 * np.pi * variance))


@pytest.mark.parametrize("feet", [True, False])
def test_a_pair_is_as_likely_as_an_integral_over_its_range_says(feet: bool) -> None:
    """Of one edge: as a foot, its range is what both ends tell; else a typical one, or nearer than it seems."""
    rng, motion = np.random.default_rng(11), np.array([0.01, -0.1, 0.05])
    one, two = (edges_from(pose, rng, POINTS[4:5], feet) for pose in (np.zeros(3), motion))
    images = TwoImages.of(one, two, CAMERA)
    move = geometry.between(CAMERA.robot_from_level, compose(motion, CAMERA.robot_from_level))
    rho, step = np.linspace(-2.5, 3.5, 60_001, retstep=True)
    d = np.sin(one.bearing[0]) - rho * move[0], -np.cos(one.bearing[0]) - rho * move[1]
    seen, both_var = np.arctan2(d[0], -d[1]) + move[2], 2 * one.bearing_sigma[0] ** 2
    (foot, later), own_var = (1.0 / edges.foot_range_m[0] for edges in (one, two)), INVERSE_SIGMA**2
    typical, agreement = TYPICAL_INVERSE_RANGE if not feet else max(TYPICAL_INVERSE_RANGE, foot), 1.0
    hangs = step * (normal(two.bearing[0], seen, both_var) * normal(rho, typical, TYPICAL_SPREAD**2)).sum()
    expected = hangs
    if feet:
        distance = loops.seen_from(one.bearing[0], foot, move)[1]
        back, back_var = later * distance, own_var * distance**2
        spread = own_var + back_var
        agreement = normal(back, foot, spread) / normal(back, foot, spread + TYPICAL_SPREAD**2)
        both = (foot * back_var + back * own_var) / spread
        ends_var = own_var * back_var / spread + images.one.common[0, 1]
        stands = step * (normal(two.bearing[0], seen, both_var) * normal(rho, both, ends_var)).sum()
        hangs *= 0.5 + 0.5 * agreement
        expected = 0.5 * (agreement * stands + hangs)
    found = loops.log_likelihoods(images, move[None], np.array([TYPICAL_INVERSE_RANGE]), False)
    assert np.expm1(found / images.weight[0]) / images.look[0] == pytest.approx([expected], rel=0.02)
    assert images.look[0] == pytest.approx(0.7 / 0.3 * TwoImages.of(one, two, CAMERA, followed=0.5).look[0])


def test_samples_have_the_mean_and_covariance_of_the_posterior() -> None:
    """A dense grid over prior times likelihood says the same as a few hundred samples."""
    for seed, move in enumerate(([0.01, -0.1, 0.08], [0.0, 0.0, -0.1], [-0.02, -0.05, 0.0])):
        rng, motion = np.random.default_rng(seed), np.array(move)
        images = TwoImages.of(edges_from(np.zeros(3), rng), edges_from(motion, rng), CAMERA)
        found = follow(images, [(ANYTHING, 0.0)])
        root = np.linalg.cholesky(found.cov)
        axis, ranges = np.linspace(-4.0, 4.0, 17), TYPICAL_INVERSE_RANGE + TYPICAL_SPREAD * np.linspace(-3.0, 3.0, 31)
        grid = np.stack(np.meshgrid(axis, axis, axis, ranges), axis=-1).reshape(-1, 4)
        grid[:, :3] = found.mean + grid[:, :3] @ root.T
        log_range = -0.5 * ((grid[:, 3] - TYPICAL_INVERSE_RANGE) / TYPICAL_SPREAD) ** 2
        moves = geometry.between(images.mounts[0], compose(grid[:, :3], images.mounts[1]))
        no_wall, wall = (loops.log_likelihoods(images, moves, grid[:, 3].copy(), on_wall) for on_wall in (False, True))
        either = np.logaddexp(no_wall + np.log(0.7), wall + np.log(0.3))
        weight = normalised(either + log_range + ANYTHING.log_density(grid[:, :3]))
        mean = weight @ grid[:, :3]
        cov = ((grid[:, :3] - mean) * weight[:, None]).T @ (grid[:, :3] - mean)
        np.testing.assert_allclose(np.linalg.solve(root, mean - found.mean), 0.0, atol=0.5)
        ratio = np.linalg.eigvalsh(np.linalg.solve(root, np.linalg.solve(root, cov).T))
        assert ratio.min() > 0.4 and ratio.max() < 2.5


def test_errors_of_a_turn_without_feet_are_within_what_is_said() -> None:
    """Edges at random ranges that nothing tells: the turn is unknown by their parallax, and no more certain."""
    square, draws = [], 100
    for draw in range(draws):
        rng = np.random.default_rng(draw)
        bearing = rng.uniform(-0.5, 0.5, 20)
        inverse = np.maximum(TYPICAL_INVERSE_RANGE + TYPICAL_SPREAD * rng.standard_normal(20), 0.02)
        points = np.stack([np.sin(bearing), -np.cos(bearing)], axis=-1) / inverse[:, None]
        points = geometry.map_from_robot(CAMERA.robot_from_level, points)
        motion = np.array([0.0, -0.05, rng.uniform(-0.1, 0.1)])
        frames = edges_from(np.zeros(3), rng, points, False), edges_from(motion, rng, points, False)
        found = followed(*frames)
        square.append((found.mean[2] - motion[2]) ** 2 / found.cov[2, 2])
    assert np.mean(square) < 1.5


@pytest.mark.parametrize("motion", [[0.0, -0.1, 0.0], [0.0, 0.0, 0.15], [0.01, -0.08, -0.12], [0.0, 0.0, 0.0]])
def test_motion_is_found_with_no_idea_beforehand(motion: list[float]) -> None:
    rng = np.random.default_rng(3)
    before, after = edges_from(np.zeros(3), rng), edges_from(np.array(motion), rng)
    found = followed(before, after)
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
    found = followed(before, Edges.from_columns(**both, **more))
    assert abs(found.mean[2] - motion[2]) < np.radians(0.1)
    np.testing.assert_allclose(found.mean[:2], motion[:2], atol=0.02)


def test_what_edges_do_not_tell_stays_as_uncertain_as_before() -> None:
    rng = np.random.default_rng(5)
    prior = np.sqrt(np.diag(ANYTHING.cov))
    none = followed(Edges.none(), edges_from(np.zeros(3), rng))
    np.testing.assert_allclose(none.cov, ANYTHING.cov)
    motion = np.array([0.0, -0.1, 0.02])
    ahead = geometry.map_from_robot(CAMERA.robot_from_level, np.array([[0.0, -4.0]]))
    one = followed(edges_from(np.zeros(3), rng, ahead), edges_from(motion, rng, ahead))
    assert (np.sqrt(np.diag(one.cov))[:2] > 0.3 * prior[:2]).all()
    blind = followed(edges_from(np.zeros(3), rng, feet=False), edges_from(motion, rng, feet=False))
    known = followed(edges_from(np.zeros(3), rng), edges_from(motion, rng))
    assert np.sqrt(blind.cov[1, 1]) > 5 * np.sqrt(known.cov[1, 1])
    unknown = edges_from(np.zeros(3), rng)
    unknown.bearing[:] = np.nan  # a lean alone, of a camera that looks straight ahead
    np.testing.assert_allclose(followed(unknown, unknown).cov, ANYTHING.cov)


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
        found = followed(before, after)
        error = found.mean - motion
        misses.append(error @ np.linalg.solve(found.cov, error))
    assert np.mean(misses) < 9.0


def test_edges_that_the_border_cuts_off_have_no_foot() -> None:
    edges = edges_from(np.zeros(3), np.random.default_rng(9))
    rows = np.linspace(300.0, 475.0, len(edges))
    edges.ends_px[:, 0] = np.stack([np.full(len(edges), 320.0), rows], axis=-1)
    np.testing.assert_array_equal(np.isnan(SeenEdges.of(edges, CAMERA).measured[:, 1]), rows > 471.0)
    edges.ends_px[:] = np.nan
    assert np.isfinite(SeenEdges.of(edges, CAMERA).measured[:, 1]).all()


def by_vision(*arguments: Any) -> tuple[Increment, Gaussian]:
    """Return how a robot moved that has no wheels, and its pace, as the filter takes it."""
    motion, pace = Odometer(CAMERA, VisualOdometryParameters(source="vision")).motion(*arguments)
    return increment_of(with_scale(motion, walks=True)), pace


def test_vision_that_sees_nothing_may_have_moved_anywhere() -> None:
    found, _ = by_vision(None, Edges.none(), 0.2, None)
    sigma = np.sqrt(np.diag(found.cov))
    np.testing.assert_allclose(sigma[1:], np.sqrt(np.diag(ANYTHING.cov))[1:], rtol=0.01)
    assert found.path_m > 0.09 and found.turned_rad > 0.1


def test_a_robot_goes_on_at_its_pace_while_nothing_is_seen_and_less_and_less_surely() -> None:
    rng, motion = np.random.default_rng(12), np.array([-0.004, -0.08, 0.1])
    seen = edges_from(motion, np.random.default_rng(13))
    _, pace = by_vision(edges_from(np.zeros(3), rng), seen, 0.2, None)
    turns, sigmas, before = [], [], seen
    for _ in range(15):
        blind, pace = by_vision(before, Edges.none(), 0.2, pace)
        turns.append(blind.mean[2])
        sigmas.append(np.sqrt(blind.cov[2, 2]))
        before = Edges.none()
    assert turns[0] == pytest.approx(motion[2] * np.exp(-0.1), rel=0.05)
    assert (np.diff(turns) < 0).all() and (np.diff(sigmas) > 0).all()
    assert sigmas[-1] == pytest.approx(np.sqrt(ANYTHING.cov[2, 2]), rel=0.05)


def test_a_robot_that_steers_is_not_thought_to_sidle_and_one_that_sidles_is_believed() -> None:
    """A wall of edges equally far shows turn and sideways motion alike; edges at many ranges tell them apart."""
    misses = []
    wall = np.array([[x_m, -2.0] for x_m in (-0.7, -0.5, -0.2, 0.0, 0.3, 0.6)])
    for seed, (points, motion) in enumerate(((wall, [0.0, 0.0, 0.1]), (POINTS, [0.08, -0.02, 0.0])) * 3):
        rng = np.random.default_rng(seed)
        frames = edges_from(np.zeros(3), rng, points), edges_from(np.array(motion), rng, points)
        found, _ = by_vision(*frames, 0.2, None)
        misses.append((found.mean - motion) / np.sqrt(np.diag(found.cov)))
        assert abs(found.mean[0] - motion[0]) < 0.02
    assert np.abs(misses).max() < 4.0


def test_moments_of_a_mixture() -> None:
    rng = np.random.default_rng(8)
    parts = [
        Gaussian(np.array([0.0, 0.1, 3.1]), 0.01 * np.eye(3)),
        Gaussian(np.array([0.2, 0.1, -3.1]), 0.04 * np.eye(3)),
    ]
    whole = mixture(parts, np.array([0.25, 0.75]))
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


STEP, SLIP = np.array([0.0, -0.02, 0.0]), np.array([0.0, -0.1, np.radians(4.0)])


def worst_error_m(source: str) -> float:
    """Return how far off the filter is at worst after wheels slipped by 0.5 m and 20° in five steps."""
    odometer = Odometer(CAMERA, VisualOdometryParameters(source=source))
    observation = EdgeObservation(CAMERA, ObservationParameters())
    filter_ = mcl.Mcl(LandmarkMap.from_points(POINTS, name="points"), observation, odometer=odometer)
    state, rng, noise = mcl.FilterState(), np.random.default_rng(1), np.random.default_rng(2)
    list(mcl.step(filter_, state, mcl.Start(0, np.zeros(3), np.diag([0.05, 0.05, 0.02]) ** 2), rng))
    true, wheels, errors = np.zeros(3), np.zeros(3), []
    for index in range(9):
        t_ns = index * 200_000_000
        events = [mcl.Odometry(t_ns, wheels), mcl.Sighting(t_ns, edges_from(true, noise))]
        for event in events:
            errors += [np.hypot(*(out.estimate.pose - true)[:2]) for out in mcl.step(filter_, state, event, rng)]
        true = compose(true, STEP)
        wheels = compose(wheels, STEP + SLIP if 2 <= index < 7 else STEP)
    return float(max(errors[3:]))


@pytest.mark.parametrize("source", ["vision", "wheel"])
def test_a_slip_does_not_lose_the_robot(source: str) -> None:
    assert worst_error_m(source) < 0.05


def test_wheels_alone_the_default_never_follow_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError("edges were followed")

    assert VisualOdometryParameters().source == "wheel"
    monkeypatch.setattr(mcl, "increment_of", never)
    assert worst_error_m("wheel") > 0.0
    with pytest.raises(AssertionError, match="followed"):
        worst_error_m("vision")


def test_replay_by_vision(tmp_path: Path, localiser: Localiser) -> None:
    log = cut_log(CORRIDOR, tmp_path / "log", 3)
    few = ("--set", "mcl.particles=200", "--set", "mcl.start_particles=200")
    run = localiser.replay(log, tmp_path / "out", "--odometry", "vision", *few)
    figures = json.loads((run / "metrics.json").read_text())
    assert figures["complete"]
    assert "source: vision" in (run / "config.yaml").read_text()


def test_a_log_without_images_cannot_be_followed(tmp_path: Path, localiser: Localiser) -> None:
    log = write_edge_log(tmp_path / "log")
    result = localiser(
        "replay", log, "--start", "1,2,170", "--odometry", "vision", "--out", tmp_path / "out", "--no-rrd"
    )
    assert result.exit_code == 2
    assert "follows edges from image to image" in result.err and "Traceback" not in result.err


def test_both_is_told_to_be_gone() -> None:
    with pytest.raises(InputError, match=r"increments\.source: `both` is gone: edges check the wheels anyway"):
        read_config(None, ["increments.source=both"])
