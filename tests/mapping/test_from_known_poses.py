"""Landmarks from known poses: triangulation, tracks, association, whole drives, and the errors that places share."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mapping_worlds import parallax, world
from numpy.typing import NDArray
from scipy.sparse import csc_array
from simulated_edges import EdgeNoise, simulated_edges

from localiser import mapping
from localiser.camera import Camera, Mount
from localiser.config import read_config
from localiser.edges import Edges
from localiser.geometry import Array, Trajectory, forward, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.mapping import Built, MappingParameters, Sightings
from localiser.mapping.landmarks import fit_landmarks, triangulate
from localiser.mapping.quality import place_cov
from localiser.mapping.sightings import direction_of, per_point
from localiser.mapping.sparse import Block, Factor, Linearised
from localiser.mapping.tracks import assign, looks_alike
from localiser.storage import open_log

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.deg2rad(20.0), 0.9))
PARAMETERS = MappingParameters(place_sigma_m=0.0)  # simulated edges err by noise alone


def built_from(edges: list[Edges], camera: Camera, poses: Array) -> tuple[Sightings, Built, LandmarkMap]:
    """Build the map of a drive with known robot poses (T, 3)."""
    cameras = camera.pose_in_map(poses)
    sightings = Sightings.from_edges(edges, camera)
    track = mapping.follow(sightings, cameras, np.full(len(poses), 1e-3), PARAMETERS.tracks)
    sigma = mapping.measured_sigma(sightings, camera.focal_px, PARAMETERS)
    built = mapping.build_from_poses(sightings, track, cameras, sigma, PARAMETERS)
    made = mapping.landmark_map_of(sightings, built, cameras, sigma, camera, PARAMETERS, "test", "test")
    return sightings, built, made


# -- geometry of one landmark -----------------------------------------------------------------------------------------


@settings(max_examples=50)
@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3.1, 3.1), st.floats(0.5, 8))
def test_direction_is_the_heading_that_faces_the_point(x: float, z: float, heading: float, range_m: float) -> None:
    camera = np.array([[x, z, 0.3]])
    point = camera[:, :2] + range_m * forward(np.array([heading]))
    found, distance = direction_of(point, camera)
    assert wrap_angle(found[0] - heading) == pytest.approx(0, abs=1e-9)
    assert distance[0] == pytest.approx(range_m)


def test_derivative_of_direction_agrees_with_differences() -> None:
    camera, point, step = np.array([[0.3, -0.4, 0.0]]), np.array([[1.0, 2.0]]), 1e-6
    numeric = [
        (direction_of(point + d, camera)[0] - direction_of(point - d, camera)[0])[0] / (2 * step)
        for d in step * np.eye(2)
    ]
    assert per_point(point, camera)[0] == pytest.approx(numeric, rel=1e-6)


def rays(points: Array, sigma: float, rng: np.random.Generator) -> tuple[NDArray[np.int64], Array, Array]:
    """Return 12 bearings of each point (L, 2) from a drive past them."""
    cameras = np.stack([np.linspace(-1, 1, 12), np.linspace(0, -0.5, 12), np.zeros(12)], axis=-1)
    landmark = np.repeat(np.arange(len(points)), 12)
    seen_from = np.tile(cameras, (len(points), 1))
    direction, _ = direction_of(points[landmark], seen_from)
    return landmark, seen_from, wrap_angle(direction + sigma * rng.standard_normal(len(direction)))


def test_triangulation_agrees_with_a_general_solver() -> None:
    from scipy.optimize import least_squares

    points = np.array([[0.5, -3.0], [-2.0, -4.0], [3.0, -1.5]])
    sigma = 2e-3
    landmark, cameras, direction = rays(points, sigma, np.random.default_rng(1))
    found = triangulate(landmark, 3, cameras, direction, np.full(36, sigma))
    for index in range(3):
        own = landmark == index

        def scaled(point: Array, own: NDArray[np.bool_] = own) -> Array:
            predicted, _ = direction_of(np.tile(point, (12, 1)), cameras[own])
            return wrap_angle(direction[own] - predicted) / sigma

        oracle = least_squares(scaled, points[index], loss="cauchy", f_scale=2.0)
        assert found.points[index] == pytest.approx(oracle.x, abs=1e-4)


def test_one_wrong_bearing_does_not_move_a_landmark() -> None:
    points, sigma = np.array([[0.5, -3.0]]), 1e-3
    landmark, cameras, direction = rays(points, sigma, np.random.default_rng(3))
    direction[4] += 0.05
    found = triangulate(landmark, 1, cameras, direction, np.full(12, sigma))
    assert np.linalg.norm(found.points[0] - points[0]) < 0.02
    assert found.weight[4] < 0.01
    assert np.delete(found.weight, 4).min() > 0.1


def test_parallel_rays_make_no_certain_landmark() -> None:
    cameras = np.stack([np.zeros(6), np.linspace(0, -1, 6), np.zeros(6)], axis=-1)
    found = triangulate(np.zeros(6, dtype=np.int64), 1, cameras, np.zeros(6), np.full(6, 1e-3))
    assert np.isfinite(found.points).all()
    assert np.linalg.eigvalsh(found.cov[0])[1] > 1.0


# -- association ------------------------------------------------------------------------------------------------------


def test_assignment_finds_the_largest_sum() -> None:
    score = np.array([[5.0, 4.0], [4.5, -np.inf], [-1.0, -2.0]])
    row, column = assign(score)
    assert sorted(zip(row.tolist(), column.tolist(), strict=True)) == [(0, 1), (1, 0)]


def test_edges_of_opposite_polarity_are_never_one() -> None:
    side, polarity = np.array([[10.0, 200.0]]), np.array([1], dtype=np.int8)
    same = looks_alike(side, polarity, side, polarity)
    other = looks_alike(side, polarity, side, -polarity)
    unlike = looks_alike(side, polarity, np.array([[120.0, 90.0]]), polarity)
    unknown = looks_alike(side, polarity, np.full((1, 2), np.nan), np.zeros(1, dtype=np.int8))
    assert other[0] == -np.inf
    assert same[0] > unknown[0] == 0.0 > unlike[0]


# -- whole drives -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", ["corridor", pytest.param("office", marks=pytest.mark.slow)])
def test_known_poses_give_an_accurate_complete_honest_map(name: str, seed: int) -> None:
    drive = world(name)
    edges = drive.edges(seed)
    _, _, made = built_from(edges, drive.camera, drive.truth.poses)
    apart = np.linalg.norm(made.points[:, None] - drive.landmark_map.points[None], axis=-1)
    error, nearest = apart.min(axis=1), apart.argmin(axis=1)
    seen = drive.seen_from_apart(edges, 6.0)
    assert np.median(error) <= 0.02 and np.quantile(error, 0.95) <= 0.06
    assert (apart[:, seen].min(axis=0) <= 0.06).mean() >= 0.9
    assert (error > 0.2).mean() <= 0.05
    offset = made.points - drive.landmark_map.points[nearest]
    nees = np.einsum("li,lij,lj->l", offset, np.linalg.inv(made.cov), offset)
    # Against the median of chi-squared with two degrees of freedom: some stand where two edges were taken for one.
    assert 0.8 <= np.sqrt(np.median(nees) / (2 * np.log(2))) <= 1.3


@pytest.mark.slow
def test_places_from_rendered_images_err_as_their_covariances_say() -> None:
    log = open_log(Path(__file__).parents[2] / "logs" / "corridor")
    made = mapping.build_map(log, "truth", read_config(None, [], log.settings)).landmark_map
    apart = np.linalg.norm(made.points[:, None] - log.landmark_map.points[None], axis=-1)
    known = apart.min(axis=1) < 0.05  # others are of textures, which the true map lacks
    offset = (made.points - log.landmark_map.points[apart.argmin(axis=1)])[known]
    nees = np.einsum("li,lij,lj->l", offset, np.linalg.inv(made.cov[known]), offset)
    assert 1.0 <= nees.mean() <= 4.0


def test_heavy_clutter_makes_few_landmarks() -> None:
    drive = world("corridor")
    _, _, made = built_from(drive.edges(seed=1, clutter=10.0), drive.camera, drive.truth.poses)
    apart = np.linalg.norm(made.points[:, None] - drive.landmark_map.points[None], axis=-1)
    assert (apart.min(axis=1) > 0.2).mean() <= 0.05


def passing(noise: EdgeNoise, seed: int = 0) -> tuple[LandmarkMap, list[Edges], Array]:
    """Return three landmarks of known heights, and a drive past them."""
    true = LandmarkMap.from_points(
        np.array([[1.0, -4.0], [-1.2, -4.0], [0.7, -3.4]]),
        bottom_m=np.array([0.0, 0.4, 0.0]),
        top_m=np.array([1.0, 0.8, 3.0]),
    )
    poses = np.stack([np.zeros(30), np.linspace(0, -2.0, 30), np.zeros(30)], axis=-1)
    truth = Trajectory(np.arange(30, dtype=np.int64) * 200_000_000, poses)
    return true, simulated_edges(true, CAMERA, truth, np.random.default_rng(seed), noise=noise), poses


def test_heights_are_those_of_the_edges_and_unknown_where_every_image_cuts_them() -> None:
    true, edges, poses = passing(EdgeNoise(endpoint_sigma_px=0.2))
    _, _, made = built_from(edges, CAMERA, poses)
    order = [int(np.linalg.norm(made.points - point, axis=1).argmin()) for point in true.points]
    assert len(made) == 3
    assert made.bottom_m[order] == pytest.approx(true.bottom_m, abs=0.03)
    assert made.top_m[order[:2]] == pytest.approx(true.top_m[:2], abs=0.03)
    assert np.isnan(made.top_m[order[2]])


def test_quality_says_how_often_and_from_where_a_landmark_was_seen() -> None:
    true, edges, poses = passing(EdgeNoise(endpoint_sigma_px=0.2))
    _, _, made = built_from(edges, CAMERA, poses)
    index = int(np.linalg.norm(made.points - true.points[1], axis=1).argmin())
    frames = sum(bool((frame.landmark_id == 1).any()) for frame in edges)
    heading, _ = direction_of(np.tile(true.points[1], (30, 1)), CAMERA.pose_in_map(poses))
    shown = np.array([(frame.landmark_id == 1).any() for frame in edges])
    assert made.quality.sightings[index] == pytest.approx(frames, abs=1)
    assert made.quality.parallax_rad[index] == pytest.approx(parallax(heading[shown]), abs=0.01)
    assert made.quality.existence[index] > 0.99


POINTS = np.array([[0.0, -3.0], [0.4, -2.0]])
SIGMA_RAD, PLACE_M, CORRELATED_RAD = 1e-4, 0.006, np.pi / 4


def arc(reach_rad: float, frames: int = 30) -> Array:
    """Return cameras (T, 3) around (0, -3), 3 m away, that look at it, over an angle."""
    heading = np.linspace(-reach_rad / 2, reach_rad / 2, frames)
    return np.column_stack([3 * np.sin(heading), -3 + 3 * np.cos(heading), heading])


def wandering(heading: Array, rng: np.random.Generator) -> Array:
    """Return errors (K,) m across the line of sight of edges that are seen along headings (K,)."""
    apart = np.abs(wrap_angle(heading[:, None] - heading[None]))
    return (
        PLACE_M
        * np.linalg.cholesky(np.exp(-apart / CORRELATED_RAD) + 1e-9 * np.eye(len(heading)))
        @ rng.normal(size=len(heading))
    )


def built(cameras: Array, rng: np.random.Generator | None) -> tuple[Sightings, Built, Array]:
    """Return landmarks that are seen from all cameras (T, 3), their places off by the direction of view."""
    frames = []
    off = np.zeros((len(POINTS), len(cameras)))
    for landmark, point in enumerate(POINTS):
        heading, range_m = direction_of(np.tile(point, (len(cameras), 1)), cameras)
        if rng is not None:
            off[landmark] = wandering(heading, rng) / range_m
    for frame, camera in enumerate(cameras):
        heading, _ = direction_of(POINTS, np.tile(camera, (len(POINTS), 1)))
        bearing = wrap_angle(camera[2] - heading - off[:, frame])
        known = np.full(len(POINTS), SIGMA_RAD)
        frames.append(Edges.from_columns(bearing, known, np.zeros(len(POINTS)), known))
    sightings = Sightings.from_edges(frames, CAMERA)
    sigma = np.full(len(sightings), SIGMA_RAD)
    return sightings, fit_landmarks(sightings, np.tile(np.arange(len(POINTS)), len(cameras)), cameras, sigma), sigma


def test_it_is_the_double_sum_over_all_pairs_of_bearings() -> None:
    cameras = arc(np.deg2rad(50))[np.random.default_rng(0).permutation(30)]
    sightings, made, sigma = built(cameras, np.random.default_rng(1))
    found = place_cov(sightings, made, cameras, sigma, PLACE_M)
    for landmark in range(len(POINTS)):
        own = made.of == landmark
        seen_from = cameras[sightings.frame[own]]
        at = np.tile(made.fit.points[landmark], (own.sum(), 1))
        heading, range_m = direction_of(at, seen_from)
        pull = per_point(at, seen_from) * (made.fit.weight[own] / sigma[own] ** 2 * PLACE_M / range_m)[:, None]
        apart = np.abs(wrap_angle(heading[:, None] - heading[None]))
        cov = made.fit.cov[landmark]
        expected = cov @ pull.T @ np.exp(-apart / CORRELATED_RAD) @ pull @ cov
        np.testing.assert_allclose(found[landmark], expected, rtol=1e-6)


@pytest.mark.parametrize("reach_deg", [10.0, 90.0])
def test_landmarks_whose_edges_wander_err_as_it_says(reach_deg: float) -> None:
    cameras, nees = arc(np.deg2rad(reach_deg)), []
    rng = np.random.default_rng(2)
    for _ in range(60):
        sightings, made, sigma = built(cameras, rng)
        cov = place_cov(sightings, made, cameras, sigma, PLACE_M) + made.fit.cov
        off = made.fit.points - POINTS
        nees.append(np.einsum("li,lij,lj->l", off, np.linalg.inv(cov), off))
    assert 1.4 < np.mean(nees) < 2.8


def test_a_landmark_is_not_less_certain_for_poses_that_are_unknown() -> None:
    """What the poses add to a landmark's covariance says nothing of how its bearings weigh against each other."""
    cameras = arc(np.deg2rad(60))
    sightings, made, sigma = built(cameras, None)
    drifted = replace(made, fit=replace(made.fit, information=np.linalg.inv(made.fit.cov + 0.01 * np.eye(2))))
    found, expected = (place_cov(sightings, one, cameras, sigma, PLACE_M) for one in (drifted, made))
    np.testing.assert_array_equal(found, expected)
    assert np.sqrt(np.linalg.eigvalsh(found).max()) < 5 * PLACE_M


def some_blocks(size: int, count: int, most: int, seed: int) -> list[Block]:
    """Return measurements of `most` variables each, some of them fixed, that tell something of every variable."""
    rng = np.random.default_rng(seed)
    column = np.array([rng.permutation(np.arange(-1, size))[:most] for _ in range(count)], dtype=np.int64)
    several = Block(
        column.reshape(count, most),
        rng.standard_normal((count, most)),
        rng.standard_normal(count),
        rng.uniform(0.1, 1.0, count),
    )
    single = Block(np.arange(size)[:, None], rng.uniform(0.5, 2.0, (size, 1)), rng.standard_normal(size), np.ones(size))
    return [several, single]


def dense(blocks: list[Block], size: int) -> tuple[Array, Array]:
    """Return JᵀWJ (V, V) and JᵀWr (V,)."""
    rows = []
    for block in blocks:
        jacobian = np.zeros((len(block.residual), size + 1))
        jacobian[np.arange(len(jacobian))[:, None], block.column] = block.value  # what is fixed goes to the last column
        rows.append((jacobian[:, :size], block.residual, block.weight))
    jacobian, residual, weight = (np.concatenate(part) for part in zip(*rows, strict=True))
    return jacobian.T @ (weight[:, None] * jacobian), jacobian.T @ (weight * residual)


@pytest.mark.parametrize(("size", "count", "most"), [(1, 0, 1), (2, 3, 2), (40, 0, 1), (40, 30, 3), (40, 60, 40)])
def test_the_solution_is_that_of_dense_algebra(size: int, count: int, most: int) -> None:
    blocks, factor = some_blocks(size, count, most, seed=size), Factor()
    upper, right = Linearised(blocks, size).normal()
    matrix, gradient = dense(blocks, size)
    np.testing.assert_allclose(upper.toarray(), np.triu(matrix), atol=1e-12)
    np.testing.assert_allclose(right, gradient, atol=1e-12)
    factor.update(upper)
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(matrix, gradient), rtol=1e-6)
    factor.update(upper, damping=0.5)
    damped = matrix + 0.5 * np.diag(np.diagonal(matrix))
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(damped, gradient), rtol=1e-6)


@pytest.mark.parametrize("count", [50, 20])
def test_a_factor_serves_other_matrices_whether_or_not_values_are_at_the_same_places(count: int) -> None:
    first, other, factor = some_blocks(60, 50, 4, seed=3), some_blocks(60, count, 4, seed=3 + (count < 50)), Factor()
    other[0].value[:] = 2 * other[0].value + 0.1
    factor.update(Linearised(first, 60).normal()[0])
    upper, right = Linearised(other, 60).normal()
    factor.update(upper)
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(*dense(other, 60)), rtol=1e-6)


@pytest.mark.parametrize("pairs", [0, 1, 600])
def test_the_inverse_between_sparse_columns_is_that_of_dense_algebra(pairs: int) -> None:
    blocks, rng, factor = some_blocks(50, 40, 4, seed=7), np.random.default_rng(8), Factor()
    columns = np.where(rng.random((50, 2 * pairs)) < 0.1, rng.standard_normal((50, 2 * pairs)), 0.0)
    factor.update(Linearised(blocks, 50).normal()[0])
    of_pair = columns.T.reshape(pairs, 2, 50)
    expected = of_pair @ np.linalg.inv(dense(blocks, 50)[0]) @ of_pair.transpose(0, 2, 1)
    np.testing.assert_allclose(factor.projected(csc_array(columns)), expected, rtol=1e-6, atol=1e-9)
    whole = columns.T @ np.linalg.inv(dense(blocks, 50)[0]) @ columns
    np.testing.assert_allclose(factor.joint(csc_array(columns)), whole, rtol=1e-6, atol=1e-9)
