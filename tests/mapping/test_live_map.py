"""The map that grows while driving: against the truth, against the batch, and what it must not take for a landmark."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mapping_worlds import World, world
from scipy.optimize import least_squares

from localiser import mapping
from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.mapping import LiveMap, MappingParameters, Sightings
from localiser.mapping.live_map import LiveFeature, started
from localiser.mapping.sightings import direction_of

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(tilt_rad=0.35, height_m=1.0))
PARAMETERS = MappingParameters()
SIGMA = 1e-3


def grown(drive: World, edges: list[Edges]) -> LiveMap:
    live = LiveMap(drive.camera, PARAMETERS)
    for pose, seen in zip(drive.truth.poses, edges, strict=False):
        live.step(pose, seen)
    return live


def batch(drive: World, edges: list[Edges]) -> LandmarkMap:
    cameras = drive.camera.pose_in_map(drive.truth.poses)
    sightings = Sightings.from_edges(edges, drive.camera)
    track = mapping.follow(sightings, cameras, np.full(len(cameras), 1e-3), PARAMETERS.tracks)
    sigma = mapping.measured_sigma(sightings, drive.camera.focal_px, PARAMETERS)
    built = mapping.build_from_poses(sightings, track, cameras, sigma, PARAMETERS)
    return mapping.landmark_map_of(sightings, built, cameras, sigma, drive.camera, PARAMETERS, "", "")


def edges_at(bearing: list[float], polarity: int = 1) -> Edges:
    count = len(bearing)
    columns = np.array(bearing), np.full(count, SIGMA), np.zeros(count), np.full(count, 0.1)
    return Edges.from_columns(*columns, polarity=np.full(count, polarity, dtype=np.int8))


def drive_past(live: LiveMap, point: Array, z_m: Array, rng: np.random.Generator, polarity: int = 1) -> None:
    """Drive along x = 0 towards -z and see one edge with noise."""
    for z in z_m:
        right, ahead = point[0], z - point[1]
        live.step(np.array([0.0, z, 0.0]), edges_at([np.arctan2(right, ahead) + rng.normal(0, SIGMA)], polarity))


@pytest.mark.parametrize("name", ["corridor", pytest.param("office", marks=pytest.mark.slow)])
def test_landmarks_are_where_they_are_and_as_certain_as_they_say(name: str) -> None:
    drive = world(name)
    edges = drive.edges(seed=0)
    live = grown(drive, edges)
    apart = np.linalg.norm(live.points[:, None] - drive.landmark_map.points[None], axis=-1)
    error, offset = apart.min(axis=1), live.points - drive.landmark_map.points[apart.argmin(axis=1)]
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.95) < 0.06
    assert (error > 0.2).mean() <= 0.05
    assert (apart[:, drive.seen_from_apart(edges, 6.0)].min(axis=0) < 0.06).mean() > 0.85
    nees = np.einsum("li,lij,lj->l", offset, np.linalg.inv(live.cov), offset)
    assert 0.8 < np.sqrt(np.median(nees) / (2 * np.log(2))) < 1.3
    assert np.quantile(nees, 0.9) < 2.5 * 4.605  # 4.605 holds 90 % of a Gaussian in the plane


@pytest.mark.parametrize("name", ["corridor", pytest.param("office", marks=pytest.mark.slow)])
def test_the_batch_finds_the_same_landmarks(name: str) -> None:
    drive = world(name)
    edges = drive.edges(seed=1)
    live, whole = grown(drive, edges), batch(drive, edges)
    apart = np.linalg.norm(live.points[:, None] - whole.points[None], axis=-1)
    pairs = mapping.matches(live.points, whole.points, 0.1)
    assert len(pairs) > 0.9 * len(live)
    assert len(pairs) > 0.85 * len(whole)
    offset = live.points[pairs[:, 0]] - whole.points[pairs[:, 1]]
    total = live.cov[pairs[:, 0]] + whole.cov[pairs[:, 1]]
    distance2 = np.einsum("li,lij,lj->l", offset, np.linalg.inv(total), offset)
    assert (distance2 < 11.8).mean() > 0.95  # three sigmas of what two independent maps would differ by
    assert np.median(distance2) < 2 * np.log(2)  # they share their bearings: nearer than independent ones
    assert np.median(apart.min(axis=1)) < 0.005


def test_no_image_makes_a_landmark_less_certain() -> None:
    drive = world("corridor")
    live = LiveMap(drive.camera, PARAMETERS)
    before = live.cov
    count = []
    for pose, seen in zip(drive.truth.poses[:80], drive.edges(seed=0)[:80], strict=True):
        live.step(pose, seen)
        gained = before - live.cov[: len(before)]
        assert (np.linalg.eigvalsh(gained) > -1e-9).all()
        before = live.cov
        count.append(len(live))
    assert count == sorted(count)
    assert count[-1] > 10 > count[0] == 0


def test_what_is_known_depends_on_the_past_alone() -> None:
    drive = world("corridor")
    edges = drive.edges(seed=0)
    half, whole = grown(drive, edges[:60]), LiveMap(drive.camera, PARAMETERS)
    for number, (pose, seen) in enumerate(zip(drive.truth.poses, edges, strict=True)):
        if number == 60:
            break
        whole.step(pose, seen)
    np.testing.assert_array_equal(half.points, whole.points)


@pytest.mark.parametrize("name", ["corridor", pytest.param("office", marks=pytest.mark.slow)])
def test_clutter_makes_no_landmark(name: str) -> None:
    drive = world(name)
    clutter = [seen.take(seen.landmark_id < 0) for seen in drive.edges(seed=2, clutter=4.0)]
    assert len(grown(drive, clutter)) == 0


def test_parallax_comes_before_a_landmark() -> None:
    point, rng = np.array([1.0, -5.0]), np.random.default_rng(0)
    z = np.linspace(0.0, -2.5, 60)
    seen_under = np.arctan2(point[0], z - point[1])
    enough = int(np.argmax(seen_under - seen_under[0] > np.deg2rad(PARAMETERS.parallax_min_deg)))
    live = LiveMap(CAMERA, PARAMETERS)
    drive_past(live, point, z[: enough - 3], rng)
    assert len(live) == 0
    drive_past(live, point, z[enough - 3 :], rng)
    assert len(live) == 1
    assert live.points[0] == pytest.approx(point, abs=4 * np.sqrt(live.cov[0].max()))


def test_the_filter_agrees_with_least_squares_over_the_same_bearings() -> None:
    point, rng = np.array([1.2, -4.0]), np.random.default_rng(3)
    z = np.linspace(0.0, -2.5, 50)
    cameras = np.stack([np.zeros(50), z, np.zeros(50)], axis=-1)
    heading = -np.arctan2(point[0], z - point[1]) + rng.normal(0, SIGMA, 50)
    feature = started(0, cameras[0], heading[0], SIGMA, 1.0, 0)
    for k in range(1, 50):
        feature.see(cameras[k], heading[k], SIGMA)
    assert feature.is_near_enough_gaussian
    feature.become_point()
    fit = least_squares(lambda at: (direction_of(np.tile(at, (50, 1)), cameras)[0] - heading) / SIGMA, point)
    cov = np.linalg.inv(fit.jac.T @ fit.jac)
    offset = feature.filter.x - fit.x
    assert offset @ np.linalg.solve(cov, offset) < 0.05
    np.testing.assert_allclose(feature.filter.P, cov, rtol=0.1)


@pytest.mark.parametrize("as_point", [False, True])
def test_jacobians_are_the_derivatives_of_the_predicted_heading(as_point: bool) -> None:
    feature = seen_well() if as_point else started(0, np.array([0.3, -0.2, 0.4]), 0.2, SIGMA, 1.0, 0)
    feature.is_point = as_point
    camera, state, step = np.array([1.0, 0.5, 0.1]), feature.filter.x, 1e-6
    moved = [
        feature.prediction(state + d, camera)[0] - feature.prediction(state - d, camera)[0] for d in step * np.eye(2)
    ]
    assert feature.prediction(state, camera)[1][0] == pytest.approx(np.ravel(moved) / (2 * step), abs=1e-6)


def seen_well() -> LiveFeature:
    """Return a point near (1, -4), seen from a drive of a metre."""
    point, rng = np.array([1.0, -4.0]), np.random.default_rng(1)
    feature = started(0, np.zeros(3), -float(np.arctan2(1.0, 4.0)), 5 * SIGMA, 1.0, 0)
    for z in np.linspace(-0.05, -1.0, 12):
        feature.see(np.array([0.0, z, 0.0]), -np.arctan2(point[0], z - point[1]) + rng.normal(0, 5 * SIGMA), 5 * SIGMA)
    feature.become_point()
    return feature


def test_what_is_seen_again_after_it_was_lost_is_one_landmark() -> None:
    point, rng, live = np.array([1.0, -5.0]), np.random.default_rng(0), LiveMap(CAMERA, PARAMETERS)
    z = np.linspace(0.0, -3.0, 60)
    drive_past(live, point, z, rng)
    alone = live.cov[0]
    for _ in range(PARAMETERS.tracks.missed_most + 3):
        live.step(np.array([0.0, -3.0, np.pi]), Edges.none())
    drive_past(live, point, z, rng)
    assert len(live) == 1
    assert live.landmark_map("", "").quality.sightings[0] > 100
    assert np.linalg.det(live.cov[0]) < 0.5 * np.linalg.det(alone)
    # Of the other polarity it is another edge.
    for _ in range(PARAMETERS.tracks.missed_most + 3):
        live.step(np.array([0.0, -3.0, np.pi]), Edges.none())
    drive_past(live, point, z, rng, polarity=-1)
    assert len(live) == 2
    assert sorted(live.landmark_map("", "").polarity.tolist()) == [-1, 1]


def test_edges_of_the_wrong_polarity_or_far_off_are_something_new() -> None:
    live, point = LiveMap(CAMERA, PARAMETERS), np.array([1.0, -5.0])
    drive_past(live, point, np.linspace(0.0, -2.0, 40), np.random.default_rng(0))
    (number,) = live.step(np.array([0.0, -2.0, 0.0]), edges_at([np.arctan2(1.0, 3.0)])).feature
    here = np.array([0.0, -2.0, 0.0])
    assert live.step(here, edges_at([np.arctan2(1.0, 3.0)])).is_landmark.tolist() == [True]
    assert live.step(here, edges_at([np.arctan2(1.0, 3.0)], polarity=-1)).feature[0] != number
    assert live.step(here, edges_at([np.arctan2(1.0, 3.0) + 0.05])).feature[0] != number
    assert live.step(here, edges_at([np.arctan2(1.0, 3.0)])).feature[0] == number


def test_a_landmark_map_says_how_good_its_landmarks_are() -> None:
    drive = world("corridor")
    made = grown(drive, drive.edges(seed=0)).landmark_map("mine", "driven")
    assert made.name == "mine"
    assert made.source[0] == "driven"
    assert made.quality is not None
    assert (made.quality.existence > PARAMETERS.existence_min).mean() > 0.9
    assert (np.rad2deg(made.quality.parallax_rad) >= PARAMETERS.parallax_min_deg - 1e-9).all()
    assert (made.quality.sightings >= PARAMETERS.sightings_min).all()
    assert np.isfinite(made.cov).all()
    assert len(replace(made, name="").ids) == len(set(made.ids))
