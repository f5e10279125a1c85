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
from localiser.visual_odometry import (
    Gaussian,
    Odometer,
    TwoImages,
    VisualOdometryParameters,
    increment_of,
    likely_motions,
    with_scale,
)
from localiser.visual_odometry import twist_kernel as loops
from localiser.visual_odometry.estimate import at_least, follow, mixture
from localiser.visual_odometry.two_images import TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD, SeenEdges
from paper.slopes import depth_from_slopes, lean_from_slope, rotation_from_slopes

ANYTHING = VisualOdometryParameters().expected(None, 0.2)


def followed(before: Edges, after: Edges) -> tuple[Gaussian, Array]:
    """Return the motion in 0.2 s of which nothing is known but two images, and the pairs of edges (M, 2)."""
    images = TwoImages.of(before, after, CAMERA)
    found = follow(images, likely_motions(images, ANYTHING), [(ANYTHING, 0.0)])
    return found.motion, images.pairs[found.chosen]


motions = st.tuples(st.floats(-0.05, 0.05), st.floats(-0.2, 0.1), st.floats(-0.2, 0.2)).map(np.array)


@settings(max_examples=50)  # the first call compiles
@given(motions, st.floats(-0.5, 0.5), st.floats(0.0, 1.5))
def test_what_the_moved_camera_sees(motion: Array, bearing: float, inverse: float) -> None:
    before, moved = CAMERA.robot_from_level, np.array([0.03, -0.1, 0.0])
    mount = np.append(before, moved[:2])
    expected = geometry.between(before, geometry.compose(motion, before + moved))
    x, z, jac = loops.camera_moved(motion, mount)
    np.testing.assert_allclose([x, z], expected[:2], atol=1e-9)
    step = 1e-6
    for column, change in enumerate(step * np.eye(3)):
        ends = [np.array(loops.camera_moved(motion + sign * change, mount)[:2]) for sign in (1, -1)]
        np.testing.assert_allclose(jac[:, column], (ends[0] - ends[1]) / (2 * step), atol=1e-6)
    seen, *_, distance = loops.seen_from(bearing, inverse, x, z, motion[2])
    if inverse > 0.01:
        point = np.array([np.sin(bearing), -np.cos(bearing)]) / inverse
        at = geometry.robot_from_map(expected, point)
        assert seen == pytest.approx(float(geometry.bearing_from_point(*at)))
        assert inverse / distance == pytest.approx(1.0 / np.hypot(*at))


def test_turning_on_the_spot_is_equation_13_of_the_paper() -> None:
    tilt = np.radians(30.0)
    slopes = np.tan(np.radians([106.82, 95.16]))
    bearings = geometry.bearing_from_lean(lean_from_slope(slopes), tilt)
    turn = float(rotation_from_slopes(slopes[0], slopes[1], tilt))
    assert loops.seen_from(bearings[0], 0.4, 0.0, 0.0, turn)[0] == pytest.approx(bearings[1])


def test_driving_straight_on_is_equation_10_of_the_paper() -> None:
    tilt, ahead_m, driven_m, right_m = np.radians(30.0), 3.0, 0.5, 0.8
    bearing = float(np.arctan2(right_m, ahead_m))
    seen = loops.seen_from(bearing, 1.0 / np.hypot(right_m, ahead_m), 0.0, -driven_m, 0.0)[0]
    slopes = geometry.slope_from_lean(geometry.lean_from_bearing(np.array([bearing, seen]), tilt))
    assert depth_from_slopes(*slopes, -driven_m) == pytest.approx(-ahead_m)


def solved(images: TwoImages, weight: Array, floor: Array, start: Array, prior: Gaussian) -> tuple[Array, Array]:
    """Return what least squares make of edges of two images that are in the same order."""
    count, size = len(weight), 4 + images.one.common.shape[2]
    mean, information = np.zeros(size), np.eye(size)
    mean[:3], mean[-1] = prior.mean, TYPICAL_INVERSE_RANGE
    information[:3, :3], information[-1, -1] = np.linalg.inv(prior.cov), TYPICAL_SPREAD**-2
    pairs = np.stack([np.arange(count)] * 2, axis=-1)
    return loops.solve(images._replace(pairs=pairs), np.arange(count), weight, floor, start, mean, information)


BY_WHEELS = Gaussian(np.array([0.0, -0.096, 0.09]), np.diag([1e-3, 9e-3, 0.01]) ** 2)


@pytest.mark.parametrize(("floor", "prior"), [(1.0, ANYTHING), (0.6, ANYTHING), (0.0, BY_WHEELS)])
def test_least_squares_agrees_with_a_general_solver(floor: float, prior: Gaussian) -> None:
    """The least sum of squares over motion, common errors, typical range and every edge's own unknowns."""
    from scipy.optimize import least_squares

    rng, true = np.random.default_rng(11), np.array([0.01, -0.1, 0.08])
    images = TwoImages.of(edges_from(np.zeros(3), rng), edges_from(true, rng), CAMERA)
    one, two, mount, uneven = images.one, images.two, images.mount, images.uneven
    count, terms = len(POINTS), one.common.shape[2]
    weight = rng.uniform(0.3, 1.0, count)
    found, cov = solved(images, weight, np.full(count, floor), true, prior)
    root = np.linalg.cholesky(np.linalg.inv(prior.cov)).T

    def cost(unknown: Array) -> Array:
        motion, wrong, typical = unknown[:3], unknown[3 : 3 + terms], unknown[3 + terms]
        bearing, inverse = unknown[4 + terms :].reshape(count, 2).T
        x, z, _ = loops.camera_moved(motion, mount)
        d = np.stack([np.sin(bearing) - inverse * x, -np.cos(bearing) - inverse * z])
        seen = np.arctan2(d[0], -d[1]) + motion[2], inverse / np.hypot(*d)
        parts = [root @ (motion - prior.mean), wrong, [(typical - TYPICAL_INVERSE_RANGE) / TYPICAL_SPREAD]]
        parts.append(np.sqrt(weight) * (inverse - typical) / TYPICAL_SPREAD)
        for frame, expected in ((one, (bearing, inverse)), (two, seen)):
            own = np.sqrt(frame.sigma[:, 1] ** 2 + 2 * (uneven * frame.measured[:, 1]) ** 2)
            for column, sigma in ((0, frame.sigma[:, 0]), (1, own / np.sqrt(max(floor, 1e-12)))):
                error = frame.measured[:, column] - expected[column] - frame.common[:, column] @ wrong
                parts.append(np.sqrt(weight) * error / sigma)
        return np.concatenate(parts)

    start = np.concatenate(
        [np.zeros(3 + terms), [TYPICAL_INVERSE_RANGE], np.stack([one.measured[:, 0], np.full(count, 0.4)], -1).ravel()]
    )
    best = least_squares(cost, start, x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    expected = np.linalg.inv(best.jac.T @ best.jac)[:3, :3]
    sigma = np.sqrt(np.diag(expected))
    # Three steps of Gauss-Newton leave some hundredths of a sigma.
    np.testing.assert_allclose(found[:3] / sigma, best.x[:3] / sigma, atol=0.1)
    np.testing.assert_allclose(cov[:3, :3] / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=0.1)


def test_without_feet_the_turn_on_a_known_way_is_as_exact_as_theory_has_it() -> None:
    """Bearings change by ψ + a ρ with ρ = μ + s n, μ = typical + s m: generalised least squares says how exact ψ is.

    Bearings have errors in both frames, n is of each edge, m of all. Errors of ψ over that sigma are standard normal.
    """
    from scipy.stats import chi2

    mount, draws, count, bearing_sigma = np.zeros(5), 200, 20, 1e-4
    way, rng = np.array([0.0, -0.02, 0.0]), np.random.default_rng(16)  # so short that bearings are linear in ρ
    prior = Gaussian(way, np.diag([1e-12, 1e-12, 1.0]))
    none, share, errors = np.full(count, np.nan), np.ones(count), []
    for _ in range(draws):
        bearing = rng.uniform(-0.5, 0.5, count)
        inverse = TYPICAL_INVERSE_RANGE + TYPICAL_SPREAD * (rng.standard_normal() + rng.standard_normal(count))
        turn = rng.uniform(-0.1, 0.1)
        x, z, _ = loops.camera_moved(np.append(way[:2], turn), mount)
        seen = np.array([loops.seen_from(b, rho, x, z, turn)[0] for b, rho in zip(bearing, inverse, strict=True)])
        one, two = (
            SeenEdges(
                np.stack([angle + bearing_sigma * rng.standard_normal(count), none], axis=-1),
                np.stack([np.full(count, bearing_sigma), none], axis=-1),
                np.zeros((count, 2, 1)),
            )
            for angle in (bearing, seen)
        )
        images = TwoImages(one, two, np.zeros((0, 2), np.int64), share, mount, 0.0, 1.0)
        found, cov = solved(images, share, 0.0 * share, way, prior)
        slope = -(np.cos(bearing) * x + np.sin(bearing) * z)
        error_cov = 2 * bearing_sigma**2 * np.eye(count)
        error_cov += TYPICAL_SPREAD**2 * (np.diag(slope**2) + np.outer(slope, slope))
        sigma = np.linalg.inv(error_cov).sum() ** -0.5
        assert np.sqrt(cov[2, 2]) == pytest.approx(sigma, rel=0.1)
        errors.append((found[2] - turn) / sigma)
    low, high = chi2.ppf([0.001, 0.999], draws)
    assert low < np.square(errors).sum() < high


@pytest.mark.parametrize("motion", [[0.0, -0.1, 0.0], [0.0, 0.0, 0.15], [0.01, -0.08, -0.12], [0.0, 0.0, 0.0]])
def test_motion_is_found_with_no_idea_beforehand(motion: list[float]) -> None:
    rng = np.random.default_rng(3)
    before, after = edges_from(np.zeros(3), rng), edges_from(np.array(motion), rng)
    found, pairs = followed(before, after)
    first, second = pairs.T
    np.testing.assert_array_equal(first, second)
    assert len(first) >= 8
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
    found, _ = followed(before, Edges.from_columns(**both, **more))
    assert abs(found.mean[2] - motion[2]) < np.radians(0.1)
    np.testing.assert_allclose(found.mean[:2], motion[:2], atol=0.02)


def test_what_edges_do_not_tell_stays_as_uncertain_as_before() -> None:
    rng = np.random.default_rng(5)
    prior = np.sqrt(np.diag(ANYTHING.cov))
    none, _ = followed(Edges.none(), edges_from(np.zeros(3), rng))
    np.testing.assert_allclose(none.cov, ANYTHING.cov)
    motion = np.array([0.0, -0.1, 0.02])
    ahead = geometry.map_from_robot(CAMERA.robot_from_level, np.array([[0.0, -4.0]]))
    one, _ = followed(edges_from(np.zeros(3), rng, ahead), edges_from(motion, rng, ahead))
    assert (np.sqrt(np.diag(one.cov))[:2] > 0.3 * prior[:2]).all()
    blind, _ = followed(edges_from(np.zeros(3), rng, feet=False), edges_from(motion, rng, feet=False))
    known, _ = followed(edges_from(np.zeros(3), rng), edges_from(motion, rng))
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
        found, pairs = followed(before, after)
        assert len(pairs) >= 6
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


def test_unknowns_are_eliminated_in_place() -> None:
    rng = np.random.default_rng(15)
    root, right = rng.standard_normal((7, 7)), rng.standard_normal(7)
    matrix = root @ root.T + 0.1 * np.eye(7)
    whole, some = (np.column_stack([matrix, right]) for _ in range(2))
    loops.eliminate(whole, 7)
    np.testing.assert_allclose(whole[:, :7] @ matrix, np.eye(7), atol=1e-9)
    np.testing.assert_allclose(whole[:, 7], np.linalg.solve(matrix, right), atol=1e-9)
    loops.eliminate(some, 2)
    schur = matrix[2:, 2:] - matrix[2:, :2] @ np.linalg.solve(matrix[:2, :2], matrix[:2, 2:])
    np.testing.assert_allclose(some[2:, 2:7], schur, atol=1e-9)


def test_each_edge_joins_one_pair_the_likeliest_first() -> None:
    pairs = np.array([[0, 0], [0, 1], [1, 0], [1, 1], [2, 1], [2, 2]])
    odds = np.array([5.0, 9.0, 8.0, 1.0, 7.0, 0.9])
    np.testing.assert_array_equal(loops.one_to_one(pairs, odds, 3, 3), [1, 2])


def test_at_least_reaches_as_far_as_both() -> None:
    rng = np.random.default_rng(14)
    one, two = (a @ a.T + 0.1 * np.eye(3) for a in rng.standard_normal((2, 3, 3)))
    whole = at_least(one, two)
    for part in (one, two):
        assert np.linalg.eigvalsh(whole - part).min() > -1e-9
    np.testing.assert_allclose(at_least(one, 0.5 * one), one, atol=1e-12)
    np.testing.assert_allclose(at_least(one, 2.0 * one), 2.0 * one, atol=1e-12)


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
