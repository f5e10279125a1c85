"""Landmarks from known poses: triangulation, tracks, association, and whole drives."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mapping_worlds import parallax, world
from numpy.typing import NDArray
from simulated_edges import EdgeNoise, simulated_edges

from localiser import mapping
from localiser.camera import Camera, Mount
from localiser.config import read_config
from localiser.edges import Edges
from localiser.geometry import Array, Trajectory, forward, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.mapping import Built, MappingParameters, Sightings
from localiser.mapping.landmarks import triangulate
from localiser.mapping.sightings import direction_of, per_point
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
    assert np.median(error) <= 0.02
    assert np.quantile(error, 0.95) <= 0.06
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
