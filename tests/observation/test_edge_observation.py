"""The observation model against plain loops."""

from dataclasses import replace
from math import comb

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_likelihood import compared, plain_pairs
from simulated_edges import EdgeNoise, simulated_edges

from localiser import geometry
from localiser.camera import Camera, Mount
from localiser.edges import CommonError, Edges
from localiser.geometry import Array, Increment, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation, ObservationParameters, Sighting, novelty_of
from localiser.particles import POSE, Particles

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20), 0.9, yaw_rad=0.03, back_m=-0.1))
KINDS = ("line", "slope")
POSE_TRUE = np.array([0.2, 1.0, 0.1])


def particles_at(poses: Array) -> Particles:
    return Particles(POSE, poses.T.copy(), np.zeros(len(poses)))


def some_map(rng: np.random.Generator, count: int = 30, cov_m: float | None = None) -> LandmarkMap:
    landmark_map = LandmarkMap.from_points(rng.uniform([-4, -6], [4, 1], size=(count, 2)))
    if cov_m is None:
        return landmark_map
    root = cov_m * rng.normal(size=(count, 2, 2))
    return replace(landmark_map, cov=root @ root.transpose(0, 2, 1))


def some_edges(rng: np.random.Generator, count: int, common: bool) -> Edges:
    bearing = rng.uniform(-0.5, 0.5, count)
    edges = Edges.from_columns(
        bearing,
        rng.uniform(0.001, 0.01, count),
        geometry.lean_from_bearing(rng.uniform(-0.5, 0.5, count), CAMERA.mount.tilt_rad),
        rng.uniform(0.002, 0.02, count),
    )
    if not common:
        return edges
    from_lean, from_line = CAMERA.bearing_jacobians(bearing, rng.uniform(-0.3, 0.3, count))
    cov = np.array([[0.005**2, 1e-6], [1e-6, 0.003**2]])
    return replace(edges, common=CommonError(("tilt", "roll"), cov, from_lean, from_line))


def landmark_densities(observation: EdgeObservation, pose: Array, edges: Edges, landmark_map: LandmarkMap) -> Array:
    """N(q_e; q_l, σ_el²) (E, L) of a map without heights, nan for landmarks out of sight, by plain loops."""
    nothing, camera_pose = np.zeros(len(landmark_map)), CAMERA.pose_in_map(pose)
    pairs, seen = plain_pairs(observation, camera_pose, Sighting(0, edges), landmark_map, nothing)
    density = np.full((len(edges), len(landmark_map)), np.nan)
    density[:, [*seen]] = 0.0
    for (e, landmark), (_, _, each) in pairs.items():
        density[e, landmark] = each
    return density


def clutter_density(kind: str) -> float:
    """1 / span: of the bearings at the middle row, from the left to the right border of the image."""
    left, right, _, _ = CAMERA.upright_bounds
    tilt_rad = CAMERA.mount.tilt_rad
    ends = [compared(kind, float(np.arctan(a / np.cos(tilt_rad))), tilt_rad)[0] for a in (left, right)]
    return 1.0 / (ends[1] - ends[0])


def oracle(observation: EdgeObservation, pose: Array, edges: Edges, landmark_map: LandmarkMap) -> float:
    """log ∫ Π_e p(q_e | pose, w) p(w) dw, relative to all edges being clutter, exactly: w is Beta(½, ½)."""
    density = landmark_densities(observation, pose, edges, landmark_map)
    visible = (~np.isnan(density[0])).sum() if len(edges) else 0
    clutter = clutter_density(observation.parameters.kind)
    product = np.polynomial.Polynomial([1.0])
    for row in density:
        ratio = np.nansum(row) / visible / clutter if visible else 0.0
        product *= np.polynomial.Polynomial([1.0, ratio - 1.0])
    moments = [comb(2 * power, power) / 4**power for power in range(len(product.coef))]
    return float(np.log(product.coef @ moments))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("common", [False, True])
@pytest.mark.parametrize("cov_m", [None, 0.05])
@pytest.mark.parametrize("count", [1, 4, 11])
def test_log_likelihood_is_the_docstring(kind: str, common: bool, cov_m: float | None, count: int) -> None:
    """Exact up to the gate for as many edges as the quadrature over w is exact for: a polynomial of degree 11."""
    rng = np.random.default_rng([count, common])
    observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind))  # type: ignore[arg-type]
    landmark_map, edges = some_map(rng, cov_m=cov_m), some_edges(rng, count, common)
    poses = np.concatenate([rng.normal(POSE_TRUE, [0.5, 0.5, 0.5], size=(40, 3)), [[0, 50, 0]]])
    found = observation.log_likelihood(particles_at(poses), Sighting(0, edges), landmark_map)
    expected = [oracle(observation, pose, edges, landmark_map) for pose in poses]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=2e-6)
    assert np.ptp(found) > 0.5, "poses must differ for the comparison to mean anything"


@pytest.mark.parametrize("kind", KINDS)
def test_differences_between_poses_hold_for_many_edges(kind: str) -> None:
    """Where the quadrature is no longer exact it must not change which pose is likelier: 0.5 of a log-ratio of tens."""
    rng = np.random.default_rng(11)
    observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind))  # type: ignore[arg-type]
    landmark_map = some_map(rng)
    (edges,) = simulated_edges(landmark_map, CAMERA, Trajectory(np.zeros(1, dtype=np.int64), POSE_TRUE[None]), rng)
    assert len(edges) > 8
    poses = POSE_TRUE + rng.normal(size=(40, 3)) * [0.05, 0.05, 0.01]
    found = observation.log_likelihood(particles_at(poses), Sighting(0, edges), landmark_map)
    expected = np.array([oracle(observation, pose, edges, landmark_map) for pose in poses])
    assert np.ptp(expected) > 10
    np.testing.assert_allclose(found - found.max(), expected - expected.max(), atol=0.5)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_measured_or_nothing_in_view_tells_nothing_of_the_landmarks(kind: str) -> None:
    observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind))  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    landmark_map, edges = some_map(rng), some_edges(rng, 5, common=True)
    near, away = particles_at(POSE_TRUE[None]), particles_at(np.array([[0.0, 100.0, 0.0], [50.0, 0.0, 1.0]]))
    np.testing.assert_allclose(
        observation.log_likelihood(near, Sighting(0, Edges.none()), landmark_map), [0.0], atol=1e-12
    )
    # E (1 - w)^5: all five are clutter, wherever the particle is.
    expected = np.log(comb(10, 5) / 4**5)
    np.testing.assert_allclose(observation.log_likelihood(away, Sighting(0, edges), landmark_map), expected, rtol=1e-12)
    matches = observation.associate(away.poses[0], Sighting(0, edges), landmark_map).matches()
    assert (matches.landmark == -1).all()
    assert np.isnan(matches.residual).all()
    assert not matches.visible.any()


@pytest.mark.parametrize("kind", KINDS)
def test_blur_is_a_sigma_of_every_edge(kind: str) -> None:
    rng = np.random.default_rng(8)
    observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind))  # type: ignore[arg-type]
    landmark_map, edges = some_map(rng), some_edges(rng, 6, common=False)
    poses = particles_at(rng.normal(POSE_TRUE, [0.5, 0.5, 0.5], size=(20, 3)))
    blurred = replace(
        edges, bearing_sigma=np.hypot(edges.bearing_sigma, 0.02), lean_sigma=np.hypot(edges.lean_sigma, 0.02)
    )
    found = observation.by_rate(poses, Sighting(0, edges), landmark_map, blur_rad=0.02)
    np.testing.assert_allclose(
        found, observation.by_rate(poses, Sighting(0, blurred), landmark_map), rtol=1e-9, atol=1e-9
    )
    assert np.abs(found - observation.by_rate(poses, Sighting(0, edges), landmark_map)).max() > 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_scales_are_the_spread_of_predictions_and_the_sigma_of_measuring(kind: str) -> None:
    """A cloud that is uncertain of its heading alone predicts bearings that spread as the heading does."""
    rng = np.random.default_rng(9)
    observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind, landmark_sigma_m=0.0))  # type: ignore[arg-type]
    landmark_map = LandmarkMap.from_points(np.array([[-0.4, -4.0], [0.1, -4.0], [0.4, -3.5]]))
    edges = replace(some_edges(rng, 5, common=False), bearing_sigma=np.full(5, 0.004), lean_sigma=np.full(5, 0.003))
    cloud = particles_at(np.column_stack([np.zeros((4000, 2)), rng.normal(0.0, 0.02, 4000)]))
    spread_rad, sigma_rad = observation.scales(cloud, Sighting(0, edges), landmark_map)
    # Near straight ahead a lean is sin(tilt) times the bearing. 64 particles tell a sigma to a tenth: 3 sigmas.
    per_bearing = 1.0 if kind == "line" else np.sin(CAMERA.mount.tilt_rad)
    assert spread_rad == pytest.approx(0.02 * per_bearing, rel=0.3)
    assert sigma_rad == pytest.approx(0.004 if kind == "line" else 0.003)
    assert observation.scales(cloud, Sighting(0, Edges.none()), landmark_map) == (0.0, np.inf)
    away = particles_at(np.tile([0.0, 100.0, 0.0], (10, 1)))
    assert observation.scales(away, Sighting(0, edges), landmark_map) == (0.0, np.inf)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=25)
@given(seed=st.integers(0, 10_000))
def test_the_true_pose_is_the_best_for_edges_without_noise(kind: str, seed: int) -> None:
    rng, truth = np.random.default_rng(seed), Trajectory(np.zeros(1, dtype=np.int64), POSE_TRUE[None])
    landmark_map, steps = some_map(rng, 25), rng.normal(size=(31, 3)) * [0.3, 0.3, 0.1]
    (edges,) = simulated_edges(landmark_map, CAMERA, truth, rng, noise=EdgeNoise(endpoint_sigma_px=1e-9))
    sigma, steps = np.full(len(edges), 0.003), np.where(np.abs(steps[:, 2:]) > 0.03, steps, 0.0)
    one = EdgeObservation(CAMERA, ObservationParameters(kind=kind, landmark_sigma_m=0.0))  # type: ignore[arg-type]
    seen = Sighting(0, replace(edges, lean_sigma=sigma, bearing_sigma=sigma))
    fit = one.log_likelihood(particles_at(POSE_TRUE + np.vstack([np.zeros(3), steps])), seen, landmark_map)
    assert fit.argmax() == 0


@pytest.mark.parametrize("kind", KINDS)
def test_association_is_the_likeliest_landmark_or_clutter(kind: str) -> None:
    rng = np.random.default_rng(4)
    observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind))  # type: ignore[arg-type]
    landmark_map, edges = some_map(rng, 15), some_edges(rng, 25, common=True)
    matches = observation.associate(POSE_TRUE, Sighting(0, edges), landmark_map).matches()
    density = landmark_densities(observation, POSE_TRUE, edges, landmark_map)
    np.testing.assert_array_equal(matches.visible, ~np.isnan(density[0]))
    odds = np.nanmax(density, axis=1) / matches.visible.sum() / clutter_density(kind)
    assert 3 < (odds > 1).sum() < 25, "both outcomes must occur"
    np.testing.assert_array_equal(matches.landmark, np.where(odds > 1, np.nanargmax(density, axis=1), -1))
    for column in (matches.residual, matches.sigma, matches.gate):
        np.testing.assert_array_equal(np.isnan(column), odds <= 1)
    # The gate says where an edge becomes clutter.
    z = matches.residual / matches.sigma
    assert odds[odds > 1] == pytest.approx(np.exp((matches.gate**2 - z**2) / 2)[odds > 1], rel=1e-3)


def test_association_finds_the_true_landmarks_of_simulated_edges() -> None:
    rng = np.random.default_rng(6)
    points = np.array([[-1.5, -4.0], [-0.6, -3.0], [0.1, -4.5], [1.4, -5.0], [0.9, -3.5]])
    landmark_map = LandmarkMap.from_points(points, bottom_m=np.zeros(5), top_m=np.full(5, 2.0))
    (edges,) = simulated_edges(landmark_map, CAMERA, Trajectory(np.zeros(1, dtype=np.int64), np.zeros((1, 3))), rng)
    assert len(edges) == 5
    for kind in KINDS:
        observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind))  # type: ignore[arg-type]
        matches = observation.associate(np.zeros(3), Sighting(0, edges), landmark_map).matches()
        np.testing.assert_array_equal(matches.landmark, edges.landmark_id)


def test_share_of_a_frame_that_is_new() -> None:
    """(1 - ρ)/(1 + ρ) with ρ = exp(-path/decorrelation - turned/decorrelation)."""
    parameters = ObservationParameters(decorrelation_m=0.1, decorrelation_deg=5.0)
    assert novelty_of(Increment.from_mean([0, 0, 0]), parameters) == 0.0
    assert novelty_of(Increment.from_mean([0, -10, 0]), parameters) == pytest.approx(1.0)
    rho = np.exp(-0.05 / 0.1 - np.radians(2) / np.radians(5))
    moved = Increment.from_mean([0.0, 0.05, -np.radians(2)])
    assert novelty_of(moved, parameters) == pytest.approx((1 - rho) / (1 + rho))
    assert novelty_of(Increment(np.zeros(3), np.zeros((3, 3)), 0.2, 0.0), parameters) == pytest.approx(np.tanh(1.0))
    by_slope, twice = replace(parameters, kind="slope"), Increment.from_mean([0.0, 0.1, -np.radians(4)])
    assert novelty_of(twice, by_slope) == pytest.approx(novelty_of(moved, parameters)), "errors of leans repeat longer"
    for independent in (replace(parameters, decorrelation_m=0.0), replace(parameters, decorrelation_deg=0.0)):
        assert novelty_of(Increment.from_mean(np.zeros(3)), independent) == 1.0


def test_many_short_steps_tell_as_much_as_the_path_they_make() -> None:
    """The shares of a path add up to path/(2 decorrelation): what is learned does not grow with the rate of images."""
    parameters = ObservationParameters(decorrelation_m=0.1)
    sums = [n * novelty_of(Increment.from_mean([0, -1.0 / n, 0]), parameters) for n in (100, 1000, 10_000)]
    np.testing.assert_allclose(sums, 5.0, rtol=0.01)
