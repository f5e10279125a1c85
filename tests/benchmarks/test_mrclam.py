"""The UTIAS data set: another frame, commands in place of poses, bearings to the left; landmarks from such bearings."""

from pathlib import Path

import numpy as np
import pytest
from coarse_bearings import coarse_bearings, matched
from mrclam import MrclamReader, integrated
from mrclam_files import FILES

from localiser import geometry, mapping, storage
from localiser.config import read_config
from localiser.edges import BearingSensor, Edges, complete
from localiser.errors import InputError
from localiser.geometry import Array, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.mapping import MappingParameters, Sightings, build_map, direction_of
from localiser.storage import open_log

COMMENT = "# a comment \r\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, content in FILES.items():
        (tmp_path / name).write_bytes((COMMENT + content).encode())
    return tmp_path


def test_frames_lie_where_there_is_odometry_and_truth(folder: Path) -> None:
    log = open_log(f"{folder}:2")
    assert log.name == f"{folder.name}-robot2"
    assert [frame.t_ns for frame in log.frames] == [10_500_000_000, 11_250_000_000]
    assert not log.has_images


def test_bearings_are_positive_to_the_right_and_fit_the_truth(folder: Path) -> None:
    log = open_log(f"{folder}:2")
    frame = log.frames[0]
    # At (1, 0.5) facing +x, the landmark at (2, 1) is ahead to the left.
    np.testing.assert_allclose(frame.edges.bearing, [-0.4636, 0.2, 0.3])
    pose = log.groundtruth.poses[0]
    x, z = geometry.robot_from_map(pose, log.landmark_map.points[0])
    np.testing.assert_allclose(np.arctan2(x, -z), -0.4636, atol=1e-4)


def test_commands_become_exact_arcs() -> None:
    # A quarter of a circle to the left, of radius 2, in three unequal steps; then straight on.
    times = np.array([0, 1, 4, 10, 12]) * 10**9
    rate = np.pi / 2 / 10
    path = integrated(times, np.array([2 * rate, 2 * rate, 2 * rate, 0.5, 0.0]), np.array([rate, rate, rate, 0.0, 0.0]))
    np.testing.assert_allclose(path.poses[3], [-2, -2, np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(path.poses[4], [-3, -2, np.pi / 2], atol=1e-12)
    # The same as composing the arcs one by one.
    pose = np.zeros(3)
    for step in (1, 3, 6):
        pose = geometry.compose(pose, geometry.arc_motion(np.array([0, -2 * rate]), rate * step, step))
    np.testing.assert_allclose(path.poses[3], pose, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("Robot2_Odometry.dat", "10\t1\n", "Robot2_Odometry.dat:1: expected 3 columns"),
        ("Robot2_Odometry.dat", "10\t1\t0\n9\t1\t0\n", "Robot2_Odometry.dat:2: time: expected a time not before"),
        ("Robot2_Measurement.dat", "10\t6.5\t1\t0\n", "Measurement.dat:1: barcode: expected an integer, found '6.5'"),
        ("Robot2_Measurement.dat", "10\t6\t1\t2\n", "bearing: expected a bearing within ±π/2, found 2.0"),
        (
            "Robot2_Measurement.dat",
            "9 6 1 0\n" + "10 6 1 0\n" * 2001,
            "Measurement.dat:2002: time: expected at most 2000",
        ),
        ("Robot2_Measurement.dat", "1\t6\t1\t0\n", "expected measurements while there is odometry and truth"),
        ("Landmark_Groundtruth.dat", "6 1 1 0 0\n6 2 2 0 0\n", "subject: landmark 6 given twice"),
    ],
)
def test_errors_name_file_line_and_field(folder: Path, name: str, content: str, expected: str) -> None:
    (folder / name).write_text(content)
    with pytest.raises(InputError) as caught:
        open_log(f"{folder}:2")
    assert expected in str(caught.value)


def test_robot_must_be_named_and_there(folder: Path) -> None:
    with pytest.raises(InputError, match=r"expected a robot's number, as in .*:1, found none"):
        open_log(folder, format="mrclam")
    with pytest.raises(InputError, match=r"Robot3_Odometry\.dat: no such file"):
        open_log(f"{folder}:3", format="mrclam")
    with pytest.raises(InputError, match="no such log"):
        open_log(f"{folder}:3")
    with pytest.raises(InputError, match="no such folder"):
        open_log(f"{folder}/other:3", format="mrclam")


@pytest.mark.data
@pytest.mark.parametrize("robot", [1, *(pytest.param(each, marks=pytest.mark.slow) for each in (2, 3))])
def test_real_bearings_fit_the_truth(data_dir: Path, robot: int) -> None:
    """All conversions at once: frame, sign, barcodes. Measured: bias within 0.2 degrees, sigma 0.5 to 1.2 degrees."""
    log = open_log(f"{data_dir / 'mrclam'}:{robot}")
    errors = []
    for frame in log.frames:
        edges = frame.edges.take(frame.edges.landmark_id >= 0)
        points = geometry.robot_from_map(log.groundtruth.at(frame.t_ns), log.landmark_map.points[edges.landmark_id])
        errors.append(edges.bearing - np.arctan2(points[:, 0], -points[:, 1]))
    degrees = np.degrees(geometry.wrap_angle(np.concatenate(errors)))
    assert len(degrees) > 1500
    assert abs(np.median(degrees)) < 0.3
    assert 0.3 < np.std(degrees[np.abs(degrees) < 10]) < 1.6


SENSOR = BearingSensor()
CAMERA = SENSOR.camera()
SIGMA = np.deg2rad(SENSOR.bearing_sigma_deg)
HALF_VIEW = np.deg2rad(SENSOR.half_view_deg)
PARAMETERS = MappingParameters()
PLACES = np.array([[3.0, 0.0], [3.0, 0.18], [0.0, 3.0], [-2.5, -1.0], [-2.4, -0.85], [1.0, -3.0], [-1.0, 2.5]])


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let logs of the data set be opened, and maps of them be built, in these tests alone."""
    monkeypatch.setattr("localiser.storage.open.FORMATS", [*storage.FORMATS, MrclamReader()])
    monkeypatch.setattr("localiser.mapping.build.BUILDERS", [coarse_bearings, *mapping.BUILDERS])


def wandering(rng: np.random.Generator, frames: int) -> Array:
    """Return camera poses (T, 3) all over the floor, facing anywhere."""
    return np.column_stack([rng.uniform(-2, 2, (frames, 2)), rng.uniform(-np.pi, np.pi, frames)])


def seen_from(cameras: Array, places: Array, rng: np.random.Generator, clutter: float, error_rad: float) -> Sightings:
    """Return what cameras (T, 3) see of places (L, 2): two of three in view, and false bearings between them."""
    frames = []
    for camera in cameras:
        heading, _ = direction_of(places, np.tile(camera, (len(places), 1)))
        bearing = wrap_angle(camera[2] - heading)
        shown = np.flatnonzero((np.abs(bearing) < HALF_VIEW) & (rng.random(len(places)) < 0.67))
        false = rng.uniform(-HALF_VIEW, HALF_VIEW, rng.poisson(clutter))
        bearings = np.concatenate([bearing[shown] + rng.normal(0, error_rad, len(shown)), false])
        unknown = np.full(len(bearings), np.nan)
        columns = complete(bearings, np.full(len(bearings), SIGMA), unknown, unknown, CAMERA.mount.tilt_rad)
        owner = np.concatenate([shown, np.full(len(false), -1)]).astype(np.int64)
        frames.append(Edges.from_columns(*columns, landmark_id=owner))
    return Sightings.from_edges(frames, CAMERA)


def map_of(sightings: Sightings, cameras: Array) -> LandmarkMap:
    sigma = sightings.sigma
    built, _ = coarse_bearings([cameras], sightings, sigma, PARAMETERS)
    return mapping.landmark_map_of(sightings, built, cameras, sigma, CAMERA, PARAMETERS, "test", "test")


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_neighbours_nearer_than_a_bearing_tells_are_found_apart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cameras = wandering(rng, 300)
    made = map_of(seen_from(cameras, PLACES, rng, 0.3, np.deg2rad(0.8)), cameras)
    assert matched(PLACES, made.points).max() < 0.08
    assert len(made) <= len(PLACES) + 2


def test_clutter_alone_makes_hardly_any_landmark() -> None:
    rng = np.random.default_rng(4)
    cameras = wandering(rng, 300)
    made = map_of(seen_from(cameras, np.zeros((0, 2)), rng, 2.0, SIGMA), cameras)  # of six hundred bearings
    assert len(made) <= 3


@pytest.mark.data
@pytest.mark.parametrize("robot", [1, 2, 3])
@pytest.mark.slow  # quick: the simulated drives of this file
def test_a_real_robot_finds_the_landmarks_by_bearings_alone(data_dir: Path, robot: int) -> None:
    log = open_log(data_dir / f"mrclam:{robot}")
    made = build_map(log, "truth", read_config(None, [], log.settings))
    error = matched(log.landmark_map.points, made.landmark_map.points)
    assert (error < 0.25).sum() >= 12
    assert np.median(error) <= 0.08


@pytest.mark.data
def test_coarse_bearings_alone_make_no_map(data_dir: Path) -> None:
    log = open_log(data_dir / "mrclam:1")
    with pytest.raises(InputError, match=r"expected bearings good to 0\.5°"):
        build_map(log, "slam", read_config(None, [], log.settings))
