"""How far landmarks stand from where the map has them is learnt, and makes the filter honest on poor maps."""

from dataclasses import replace

import numpy as np
import pytest
from board import changes
from board.run import START_SIGMA, located, record_of, run
from board.worlds import hours_of

from localiser import Localiser, geometry, read_config
from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.filter.map_error import SCALES, MapError
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, in_camera
from localiser.observation import EdgeObservation, ObservationParameters, Sighting

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20), 0.9))


def image_of(points: Array, kind: str, rng: np.random.Generator) -> Sighting:
    """Return the edges of points (L, 2) seen from the origin of the map, and three of clutter."""
    right, ahead = (axis[0] for axis in in_camera(CAMERA.pose_in_map(np.zeros((1, 3))), points))
    bearing = np.concatenate([np.arctan(right / ahead), rng.uniform(-0.5, 0.5, 3)])
    sigma = np.full(len(bearing), 0.0005 if kind == "line" else 0.002)
    lean = geometry.lean_from_bearing(bearing, CAMERA.mount.tilt_rad)
    noise = sigma * rng.standard_normal(len(bearing))
    return Sighting(0, Edges.from_columns(bearing + noise, sigma, lean + noise, sigma))


@pytest.mark.parametrize("kind", ["line", "slope"])
@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_the_likeliest_scale_is_that_of_the_landmarks_errors(kind: str, scale: float) -> None:
    rng = np.random.default_rng([7, int(scale), len(kind)])
    observation = EdgeObservation(CAMERA, ObservationParameters(kind=kind, landmark_sigma_m=0.01))
    total = np.zeros(len(SCALES))
    for _ in range(150):
        bearing, far_m = rng.uniform(-0.45, 0.45, 9), rng.uniform(1.5, 5.0, 9)
        points = far_m[:, None] * np.column_stack([np.sin(bearing), -np.cos(bearing)])
        sighting = image_of(points, kind, rng)
        known = LandmarkMap.from_points(points + scale * 0.01 * rng.standard_normal(points.shape))
        total += observation.associate(np.zeros(3), sighting, known).by_map_scale(SCALES)
    found = SCALES[total.argmax()]
    assert scale / 1.5 < found < scale * 1.5, dict(zip(SCALES.round(2), total.round(1), strict=True))


def test_an_image_without_edges_or_landmarks_in_view_tells_nothing() -> None:
    rng, observation = np.random.default_rng(1), EdgeObservation(CAMERA, ObservationParameters())
    behind = LandmarkMap.from_points(np.array([[0.0, 5.0]]))
    for sighting in (Sighting(0), image_of(np.array([[0.0, -2.0]]), "line", rng)):
        assert np.ptp(observation.associate(np.zeros(3), sighting, behind).by_map_scale(SCALES)) == 0.0


def test_edges_on_no_map_beside_landmarks_do_not_make_the_map_poor() -> None:
    rng, observation = np.random.default_rng(3), EdgeObservation(CAMERA, ObservationParameters(landmark_sigma_m=0.01))
    total = np.zeros(len(SCALES))
    for _ in range(100):
        bearing = np.linspace(-0.4, 0.4, 9) + rng.uniform(-0.01, 0.01, 9)
        places = 2.0 * np.column_stack([np.sin(bearing), -np.cos(bearing)])
        beside = 2.0 * np.column_stack([np.sin(bearing + 0.04), -np.cos(bearing + 0.04)])  # 8 cm
        sighting = image_of(np.concatenate([places, beside]), "line", rng)
        known = LandmarkMap.from_points(places + 0.01 * rng.standard_normal(places.shape))
        total += observation.associate(np.zeros(3), sighting, known).by_map_scale(SCALES)
    assert 0.5 < SCALES[total.argmax()] < 2.0


def test_what_is_learnt_needs_more_than_one_image_and_is_forgotten() -> None:
    told = np.where(SCALES > 3.9, 6.0, 0.0)
    known = MapError()
    assert 1.0 < known.scale < 1.25  # no map is much better than it says
    assert replace(known, novelty=0.5).after(told).scale < 2.0
    for _ in range(20):
        known = replace(known, novelty=0.5).after(told)
    assert known.scale > 4.0
    assert known.decorrelation == known.scale
    for _ in range(2000):
        known = replace(known, novelty=0.5).after(np.zeros(len(SCALES)))
    assert 1.0 < known.scale < 1.35


def test_better_maps_do_not_make_images_count_for_more() -> None:
    known = MapError()
    for _ in range(50):
        known = replace(known, novelty=1.0).after(np.where(SCALES < 0.8, 2.0, 0.0))
    assert known.scale < 1.0
    assert known.decorrelation == 1.0


def told_by(scale: float) -> Array:
    """Return log p(edges | scale) (K,) of an image with ten edges whose errors are the map's, at this scale."""
    return -10 * (np.log(SCALES) + (scale / SCALES) ** 2 / 2)


@pytest.mark.parametrize(("before", "after"), [(0.5, 4.0), (4.0, 0.5)])
def test_where_the_map_becomes_another_a_few_images_tell(before: float, after: float) -> None:
    known = MapError()
    for _ in range(1000):
        known = replace(known, novelty=1.0).after(told_by(before))
    assert known.scale == pytest.approx(before, rel=0.3)
    images = 0
    while abs(np.log(known.scale / after)) > np.log(1.5):
        known, images = replace(known, novelty=1.0).after(told_by(after)), images + 1
    assert images <= 10


@pytest.mark.parametrize("kind", ["line", pytest.param("slope", marks=pytest.mark.slow)])
def test_on_a_map_that_is_off_by_three_centimetres_the_filter_says_how_far_it_is_off(kind: str) -> None:
    drive = hours_of("crowd", 3, 0.5)
    rng, points = np.random.default_rng(5), drive.landmark_map.points
    poor = replace(drive.landmark_map, points=points + 0.03 * rng.standard_normal(points.shape))
    records = [run(drive, seed, observation=kind, landmark_map=poor) for seed in range(10)]
    assert all(record.right.all() for record in records)
    # 3 is right; 6.1 (line) and 2.5 (slope) by a filter that takes the map for as good as stated.
    assert np.mean([np.nanmean(record.nees[50:]) for record in records]) < 4.0


@pytest.mark.slow
def test_a_robot_that_is_carried_away_is_found_out_though_the_map_is_poor() -> None:
    drive = changes.carried(hours_of("shelves", 1, 1.0), 0)
    rng, points = np.random.default_rng(6), drive.landmark_map.points
    angle = rng.uniform(-np.pi, np.pi, len(points))
    poor = replace(drive.landmark_map, points=points + 0.05 * np.column_stack([np.cos(angle), np.sin(angle)]))
    robot = Localiser(poor, drive.camera, read_config(None, (), drive.settings), 0)
    robot.start(drive.truth[0], np.diag(START_SIGMA**2), int(drive.t_ns[0]))
    record, first = record_of(located(robot, drive), drive.truth, drive.landmark_map), drive.carried
    assert record.sure[first - 1]
    assert not (record.sure & ~record.right)[first:].any()
    assert (record.error_m[first + 5 :] < 0.25).all()
