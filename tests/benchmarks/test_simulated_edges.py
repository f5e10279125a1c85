"""Simulated edges: unbiased, as certain as they say, and nothing that the camera could not see; simulated buildings."""

import numpy as np
import pytest
from board.buildings import KINDS
from board.worlds import MAP_SIGMA_M, clearance_m, hidden_behind, hours_of
from cameras import vga_camera
from simulated_edges import EdgeNoise, simulated_edges

from localiser import geometry
from localiser.camera import Mount
from localiser.edges import Segments
from localiser.edges.mount import nadir_miss
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap, in_camera

CAMERA = vga_camera(
    Mount(np.deg2rad(20), 0.9, roll_rad=np.deg2rad(1), yaw_rad=np.deg2rad(2), back_m=-0.1),
    "plumb_bob",
    (-0.25, 0.0, 0.0, 0.0),
)


@pytest.fixture
def landmark_map() -> LandmarkMap:
    rng = np.random.default_rng(5)
    points = rng.uniform(-5, 5, size=(40, 2))
    return LandmarkMap.from_points(points, bottom_m=np.zeros(40), top_m=rng.uniform(0.5, 2.5, size=40))


def still(count: int, pose: tuple[float, float, float] = (0.3, 2.0, 0.2)) -> Trajectory:
    return Trajectory(np.arange(count) * 100_000_000, np.tile(pose, (count, 1)))


def test_without_noise_edges_are_where_the_landmarks_project(landmark_map: LandmarkMap) -> None:
    truth = still(1)
    (edges,) = simulated_edges(
        landmark_map, CAMERA, truth, np.random.default_rng(0), noise=EdgeNoise(endpoint_sigma_px=0.0)
    )
    assert len(edges) >= 3
    camera_pose = CAMERA.pose_in_map(truth.poses[0])
    seen = geometry.robot_from_map(camera_pose, landmark_map.points[edges.landmark_id])
    bearing = np.arctan2(seen[:, 0], -seen[:, 1])
    np.testing.assert_allclose(edges.bearing, bearing, atol=1e-12)
    np.testing.assert_allclose(edges.lean, geometry.lean_from_bearing(bearing, CAMERA.mount.tilt_rad), atol=1e-12)
    np.testing.assert_allclose(CAMERA.bearing_of_segments(edges.ends_px), bearing, atol=1e-9)


def test_errors_are_gaussian_with_the_stated_sigmas(landmark_map: LandmarkMap) -> None:
    count = 4000
    frames = simulated_edges(landmark_map, CAMERA, still(count), np.random.default_rng(1))
    (exact,) = simulated_edges(
        landmark_map, CAMERA, still(1), np.random.default_rng(0), noise=EdgeNoise(endpoint_sigma_px=0.0)
    )
    bearing = np.array([(f.bearing - exact.bearing) / f.bearing_sigma for f in frames])
    lean = np.array([(f.lean - exact.lean) / f.lean_sigma for f in frames])
    for score in (bearing, lean):
        np.testing.assert_allclose(score.mean(axis=0), 0.0, atol=4 / np.sqrt(count))
        np.testing.assert_allclose((score**2).mean(axis=0), 1.0, atol=4 * np.sqrt(2 / count))


def test_detection_probability_and_clutter_have_the_stated_means(landmark_map: LandmarkMap) -> None:
    truth = still(2000)
    everything = simulated_edges(landmark_map, CAMERA, still(1), np.random.default_rng(0))[0]
    noise = EdgeNoise(detection_probability=0.7, clutter_per_frame=3.0)
    frames = simulated_edges(landmark_map, CAMERA, truth, np.random.default_rng(2), noise=noise)
    clutter = np.array([(f.landmark_id < 0).sum() for f in frames])
    found = np.array([(f.landmark_id >= 0).sum() for f in frames])
    assert abs(clutter.mean() - 3.0) < 4 * np.sqrt(3.0 / 2000)
    assert abs(found.mean() / len(everything) - 0.7) < 4 * np.sqrt(0.21 / 2000 / len(everything))
    taken = np.concatenate([f.ends_px[f.landmark_id < 0] for f in frames[:50]])
    false = CAMERA.ideal.pixels_from_image(CAMERA.image_from_pixels(taken))
    half_px = np.linalg.norm(false[:, 1] - false[:, 0], axis=-1) / 2
    miss = nadir_miss(Segments.of_ends(false, 0.5), CAMERA, 0.0).angle
    assert np.abs(miss * half_px).max() < 3.0, "clutter is what cannot be told from a vertical edge"


SHOWN = ("shelves", "chairs", "corridors", "alike", "crowd", "floor")


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.slow) if kind == "corridors" else kind for kind in SHOWN]
)
def test_drive_hits_nothing_and_shows_the_map(kind: str) -> None:
    drive = hours_of(kind, 1, 0.5)
    number = list(KINDS).index(kind)
    building = KINDS[kind](np.random.default_rng([1, 21, number]))
    assert clearance_m(building, drive.truth[:, :2]).min() > 0.2
    assert len(drive.t_ns) == len(drive.edges) == 150
    # Edges of landmarks point where the landmark stands, but for the errors of the map.
    errors = []
    for edges, pose in zip(drive.edges, drive.truth, strict=True):
        known = edges.landmark_id >= 0
        eye = drive.camera.pose_in_map(pose[None])
        right, ahead = (axis[0] for axis in in_camera(eye, drive.landmark_map.points[edges.landmark_id[known]]))
        errors.append(np.hypot(right, ahead) * (edges.bearing[known] - np.arctan2(right, ahead)))
    across_m = np.concatenate(errors)
    assert len(across_m) > 100
    assert 0.5 < across_m.std() / MAP_SIGMA_M < 1.5


def test_walls_and_people_hide_what_is_behind_them() -> None:
    wall = np.array([[[-1.0, -2.0], [1.0, -2.0]]])
    person = np.array([[3.0, -2.0, 0.25]])
    points = np.array([[0.0, -4.0], [0.0, -1.0], [0.0, -2.0], [3.0, -4.0], [6.0, -4.0], [2.0, -4.0]])
    hidden = hidden_behind(np.zeros(2), points, wall, person)
    #        behind, before, on the wall; beside both; behind the person; beside the wall's end
    np.testing.assert_array_equal(hidden, [True, False, False, False, True, True])
