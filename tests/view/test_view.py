"""What a run looks like in Rerun: read back from the recording, and shown to viewers that misbehave."""

import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.errors import InputError, OutputError
from localiser.filter import Image, Located, LocatedFrame
from localiser.geometry import Array, Increment, Trajectory, compose, forward, robot_from_map
from localiser.landmarks import LandmarkMap, predicted_lines
from localiser.observation import Matches
from localiser.particles import Particles, effective_sample_size, from_gaussian
from localiser.view import Context, LiveView, RrdFile, palette, paths
from localiser.view.draw import CHI2_95_2D, MOST_PARTICLES, MOST_POINTS, camera_pose, ellipse_points, joins
from localiser.view.viewer import Kind, viewer_command

FRAMES, STEP_NS = 5, 200_000_000
STAGE_MS = {"load": 1.0, "edges": 20.0, "filter": 10.0}
CAMERA = Camera(
    320,
    240,
    280.0,
    282.0,
    158.0,
    121.0,
    Mount(np.deg2rad(20), 0.8, np.deg2rad(3), np.deg2rad(5), right_m=0.05, back_m=-0.15),
    distortion_model="plumb_bob",
    distortion=(-0.25, 0.05, 0.001, -0.001, 0.0),
)
MAP = LandmarkMap.from_points(
    np.array([[-0.8, -3.0], [0.6, -4.0], [0.8, -2.8], [0.0, 3.0]]),
    bottom_m=np.array([0.0, 0.4, np.nan, 0.0]),
    top_m=np.array([2.0, 1.2, np.nan, 2.0]),
)


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    """Rerun swallows wrong shapes otherwise."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(before)


def shown(located: Located, image: Image | None, truth: Array | None, stage_ms: dict[str, float]) -> LocatedFrame:
    """Edges show landmarks 0 and 1, the third is clutter; landmark 2 is expected and not found, 3 lies behind."""
    landmark = np.array([0, 1, -1])[: len(located.edges)]
    visible = np.array([True, True, True, False])
    matches = replace(Matches.none(len(landmark), len(visible)), landmark=landmark, visible=visible)
    return LocatedFrame(replace(located, matches=matches), image, truth, stage_ms)


def context(**changes: Any) -> Context:
    given = {"truth": truth()} | changes
    return Context("unit", CAMERA, given.pop("landmark_map", MAP), **given)


def truth() -> Trajectory:
    times = np.arange(FRAMES) * STEP_NS
    return Trajectory(times, np.stack([0.02 * np.arange(FRAMES), -0.1 * np.arange(FRAMES), np.zeros(FRAMES)], axis=-1))


def edges_at(pose: Array) -> Edges:
    """The visible part of landmarks 0 and 1, and one edge more; pixels as the lens shows them."""
    points = np.array(
        [[[x, low, z], [x, high, z]] for (x, z), low, high in zip(MAP.points[:2], (0.5, 0.5), (1, 1.1), strict=True)]
    )
    ends = np.concatenate([CAMERA.project(pose, points), [[[200.0, 220.0], [205.0, 150.0]]]])
    bearing = CAMERA.bearing_of_segments(ends)
    rejected = np.array([[[10.0, 10.0], [60.0, 30.0]]])
    return Edges.from_columns(bearing, bearing, bearing, bearing, ends_px=ends, rejected_px=rejected)


def frame(number: int, *, particles: int = 300, t0_ns: int = 0, seed: int = 0) -> tuple[Located, Array]:
    rng = np.random.default_rng([seed, number])
    pose = truth().poses[number % FRAMES]
    cloud = from_gaussian(pose, np.diag([0.1, 0.05, 0.02]) ** 2, particles, rng)
    cloud = Particles(cloud.names, cloud.columns, rng.normal(size=particles))
    located = Located(
        t0_ns + number * STEP_NS,
        cloud.estimate,
        cloud,
        effective_sample_size(cloud.weight),
        edges_at(pose),
        Increment.from_mean(np.zeros(3)),
        compose(np.array([5.0, 7.0, 1.0]), pose),
    )
    return located, pose


def picture() -> NDArray[np.uint8]:
    return np.random.default_rng(1).integers(0, 255, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)


def record(path: Path, *, complete: bool = True, seed: int = 0, **changes: Any) -> list[Located]:
    recorded = []
    sink = RrdFile(path, context(**changes))
    for number in range(FRAMES):
        located, pose = frame(number, seed=seed)
        sink.frame(shown(located, picture(), pose if "truth" not in changes else None, STAGE_MS))
        recorded.append(located)
    sink.close(complete)
    return recorded


def read(path: Path) -> dict[str, dict[str, list[Any]]]:
    """Every column of every entity in the order of frames, without Rerun's own ids: {entity: {column: rows}}."""
    content: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch().drop_columns("rerun.controls.RowId")
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            content[chunk.entity_path.removeprefix("/")][name].extend(column.to_pylist())
    return {entity: dict(columns) for entity, columns in content.items()}


def written(path: Path, *frames: LocatedFrame, **changes: Any) -> dict[str, dict[str, list[Any]]]:
    """Record frames; return what the recording holds."""
    sink = RrdFile(path, context(**changes))
    for one in frames:
        sink.frame(one)
    sink.close(True)
    return read(path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Located], dict[str, dict[str, list[Any]]]]:
    """Return what was located, and what the recording of it holds."""
    path = tmp_path_factory.mktemp("whole") / "run.rrd"
    return record(path), read(path)


def rerun(*arguments: object) -> list[str]:
    code = "import sys, rerun_cli.__main__ as cli; sys.exit(cli.main())"
    return [sys.executable, "-c", code, *map(str, arguments)]


def same(first: Path, second: Path) -> bool:
    command = rerun("rrd", "compare", "--unordered", first, second)
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


# -- the recording ----------------------------------------------------------------------------------------------------

EACH_FRAME = {
    *(paths.VISIBLE, paths.MATCHED, paths.SIGHTS, paths.PARTICLES, paths.ESTIMATE, paths.ELLIPSE, paths.TRUTH),
    *(*paths.TRAILS, paths.CAMERA, paths.IMAGE, paths.REJECTED, paths.PREDICTED, paths.EDGES, paths.JOINS),
    *(paths.ERROR, paths.HEADING, paths.P_CORRECT, paths.ESS, paths.COUNTS, paths.STAGES),
    *(paths.PLACES, paths.PLACE_ARROWS),
}
ONCE = {paths.WORLD, paths.LANDMARKS, paths.TRUTH_PATH}


def test_every_entity_has_one_row_a_frame_on_both_time_lines(whole: Any) -> None:
    _, content = whole
    assert set(content) == EACH_FRAME | ONCE | {paths.TEXT, "__properties"}
    for entity in EACH_FRAME:
        assert content[entity][paths.FRAME] == list(range(FRAMES)), entity
        assert [t.value for t in content[entity][paths.TIME]] == [n * STEP_NS for n in range(FRAMES)], entity
    for entity in ONCE:
        assert paths.FRAME not in content[entity], entity
    assert not any("log_time" in columns for columns in content.values())


def test_times_since_the_epoch_are_dates(tmp_path: Path) -> None:
    epoch_ns = 1_700_000_000_123_456_789
    (time,) = written(tmp_path / "run.rrd", shown(frame(0, t0_ns=epoch_ns)[0], None, None, {}))[paths.ESS][paths.TIME]
    assert time.value == epoch_ns and time.year == 2023


def test_plots_hold_error_and_three_sigma_ess_counts_and_stages(whole: Any) -> None:
    recorded, content = whole
    errors = np.array(content[paths.ERROR]["Scalars:scalars"])
    for located, pose, (error, three_sigma) in zip(recorded, truth().poses, errors, strict=True):
        assert error == pytest.approx(np.linalg.norm(located.estimate.pose[:2] - pose[:2]))
        cov = located.estimate.pose_cov
        assert three_sigma == pytest.approx(3 * np.sqrt(cov[0, 0] + cov[1, 1]))
    headings = np.deg2rad(content[paths.HEADING]["Scalars:scalars"])
    for located, pose, (error, three_sigma) in zip(recorded, truth().poses, headings, strict=True):
        assert error == pytest.approx(abs(located.estimate.pose[2] - pose[2]))
        assert three_sigma == pytest.approx(3 * np.sqrt(located.estimate.pose_cov[2, 2]))
    assert content[paths.ESS]["Scalars:scalars"] == [[pytest.approx(located.ess)] for located in recorded]
    assert content[paths.COUNTS]["Scalars:scalars"] == [[3.0, 2.0]] * FRAMES
    assert content[paths.STAGES]["Scalars:scalars"] == [list(STAGE_MS.values())] * FRAMES
    assert content[paths.STAGES]["SeriesLines:names"] == [list(STAGE_MS)]


def test_particles_are_all_there_or_evenly_thinned(tmp_path: Path) -> None:
    counts = (300, 3 * MOST_PARTICLES + 1)
    clouds = [frame(number, particles=count)[0] for number, count in enumerate(counts)]
    content = written(tmp_path / "run.rrd", *(shown(located, None, None, STAGE_MS) for located in clouds))
    few, many = (np.array(rows) for rows in content[paths.PARTICLES]["Points3D:positions"])
    assert few.shape == (300, 3)
    np.testing.assert_allclose(few[:, [0, 2]], clouds[0].particles.poses[:, :2], atol=1e-6)
    np.testing.assert_allclose(many[:, [0, 2]], clouds[1].particles.poses[::4, :2], atol=1e-6)
    assert len(many) <= MOST_PARTICLES


def test_landmarks_are_matched_expected_or_neither(whole: Any) -> None:
    _, content = whole
    (unseen,) = content[paths.LANDMARKS]["LineStrips3D:strips"]
    assert len(unseen) == len(MAP)
    matched = np.array(content[paths.MATCHED]["LineStrips3D:strips"][0])
    np.testing.assert_allclose(matched[:, :, [0, 2]], np.repeat(MAP.points[:2, None], 2, axis=1), atol=1e-6)
    np.testing.assert_allclose(matched[:, :, 1], [[0.0, 2.0], [0.4, 1.2]], atol=1e-6)
    expected = np.array(content[paths.VISIBLE]["LineStrips3D:strips"][0])
    np.testing.assert_allclose(expected, [[[0.8, 0.0, -2.8], [0.8, 1.6, -2.8]]], atol=1e-6)
    assert {len(lines) for lines in content[paths.SIGHTS]["LineStrips3D:strips"]} == {2}


def test_a_large_map_is_drawn_as_points(tmp_path: Path) -> None:
    points = np.concatenate([MAP.points, np.random.default_rng(0).uniform(-400, 400, (20_000, 2))])
    one = shown(frame(0)[0], None, None, STAGE_MS)
    visible = np.concatenate([one.matches.visible, np.zeros(20_000, dtype=bool)])
    one = replace(one, located=replace(one.located, matches=replace(one.matches, visible=visible)))
    large = {"landmark_map": LandmarkMap.from_points(points), "truth": None, "images": False}
    content = written(tmp_path / "run.rrd", one, **large)
    (coarse,) = content[paths.LANDMARKS]["Points3D:positions"]
    assert 1000 < len(coarse) <= MOST_POINTS
    assert [len(strips) for strips in content[paths.MATCHED]["LineStrips3D:strips"]] == [2]


def test_image_is_a_jpeg_of_the_cameras_size_and_files_pass_through(tmp_path: Path) -> None:
    file = cv2.imencode(".png", picture()[:, :, 0])[1].tobytes()
    frames = [shown(frame(k)[0], image, None, STAGE_MS) for k, image in enumerate([picture(), file, None])]
    image = written(tmp_path / "run.rrd", *frames)[paths.IMAGE]
    blobs = [bytes(row[0]) for row in image["EncodedImage:blob"] if row]
    decoded = cv2.imdecode(np.frombuffer(blobs[0], np.uint8), cv2.IMREAD_COLOR)
    assert decoded.shape == (CAMERA.height, CAMERA.width, 3) and blobs[1:] == [file]
    assert [row[0] for row in image["EncodedImage:media_type"] if row] == ["image/jpeg", "image/png"]
    assert image["Clear:is_recursive"] == [[False]], "an old image must not stay under new edges"


def test_edges_are_coloured_by_match_and_joined_to_what_was_expected(whole: Any) -> None:
    recorded, content = whole
    edges = content[paths.EDGES]
    np.testing.assert_allclose(edges["LineStrips2D:strips"][0], recorded[0].edges.ends_px, atol=1e-3)
    rgba = [int.from_bytes(bytes(colour), "big") for colour in (palette.MATCHED, palette.UNMATCHED)]
    assert edges["LineStrips2D:colors"][0] == [rgba[0], rgba[0], rgba[1]]
    assert [len(lines) for lines in content[paths.PREDICTED]["LineStrips2D:strips"]] == [3] * FRAMES
    assert [len(lines) for lines in content[paths.JOINS]["LineStrips2D:strips"]] == [2] * FRAMES
    assert [len(lines) for lines in content[paths.REJECTED]["LineStrips2D:strips"]] == [1] * FRAMES


def test_trails_continue_where_the_last_frame_ended(whole: Any) -> None:
    recorded, content = whole
    positions = np.array([located.estimate.pose[:2] for located in recorded])
    pieces = np.array(content[paths.ESTIMATE_TRAIL]["LineStrips3D:strips"])[:, 0][:, :, [0, 2]]
    np.testing.assert_allclose(pieces[:, 1], positions, atol=1e-6)
    np.testing.assert_allclose(pieces[1:, 0], positions[:-1], atol=1e-6)
    # Odometry, in a frame of its own, starts at the first estimate and then moves as the truth does.
    odometry = np.array(content[paths.ODOMETRY_TRAIL]["LineStrips3D:strips"])[:, 0][:, 1, [0, 2]]
    first = recorded[0].estimate.pose
    moved = robot_from_map(first, odometry)
    np.testing.assert_allclose(moved, robot_from_map(truth().poses[0], truth().poses[:, :2]), atol=1e-5)


def test_without_truth_and_images_nothing_of_them_is_logged(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd", truth=None, images=False)
    content = read(tmp_path / "run.rrd")
    assert not {paths.TRUTH, paths.TRUTH_PATH, paths.TRUTH_TRAIL, paths.IMAGE, paths.EDGES} & set(content)
    assert np.isnan(np.array(content[paths.ERROR]["Scalars:scalars"])[:, 0]).all()


@pytest.mark.parametrize(("complete", "last"), [(True, ["run complete", "INFO"]), (False, ["run ended early", "WARN"])])
def test_text_says_how_the_run_ended(tmp_path: Path, complete: bool, last: list[str]) -> None:
    record(tmp_path / "run.rrd", complete=complete)
    text = read(tmp_path / "run.rrd")[paths.TEXT]
    assert (text["TextLog:text"], text["TextLog:level"]) == ([[last[0]]], [[last[1]]])
    assert text[paths.FRAME] == [FRAMES - 1]


def test_same_frames_make_the_same_recording(tmp_path: Path) -> None:
    for name, seed in (("a.rrd", 0), ("b.rrd", 0), ("c.rrd", 1)):
        record(tmp_path / name, seed=seed)
    assert same(tmp_path / "a.rrd", tmp_path / "b.rrd")
    assert not same(tmp_path / "a.rrd", tmp_path / "c.rrd")


def test_recording_brings_its_layout(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd")
    reader = RrdReader(tmp_path / "run.rrd")
    (layout,) = reader.blueprints()
    text = "".join(str(chunk.to_record_batch().to_pydict()) for chunk in reader.stream(store=layout))
    for view in ("3D", "2D", "TimeSeries", "TextLog"):
        assert view in text
    for title in ("unit", "Image", "Position error", "Heading error", "Effective sample size", "Edges", "Messages"):
        assert title in text


def test_a_file_that_cannot_be_written_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"run\.rrd"):
        RrdFile(tmp_path / "missing" / "run.rrd", context()).close(complete=True)


# -- geometry ---------------------------------------------------------------------------------------------------------


def test_frustum_stands_where_the_camera_is() -> None:
    """A point through position, rotation and pinhole lands on the pixel that the camera says."""
    robot = np.array([1.0, -2.0, 0.7])
    ahead = robot[:2] + 3 * forward(robot[2])
    points = np.array([[ahead[0], 0.3, ahead[1]], [ahead[0] + 0.5, 1.1, ahead[1] - 0.2]])
    position, rotation = camera_pose(CAMERA, robot)
    right, up, backward = ((points - position) @ rotation).T
    pixels = np.stack([CAMERA.cx - CAMERA.fx * right / backward, CAMERA.cy + CAMERA.fy * up / backward], axis=-1)
    np.testing.assert_allclose(pixels, CAMERA.ideal.project(robot, points), atol=1e-9)


def test_ellipse_lies_where_95_percent_are_inside() -> None:
    rng = np.random.default_rng(3)
    cov = np.array([[0.04, 0.03, 0.0], [0.03, 0.09, 0.0], [0.0, 0.0, 0.01]])
    located = from_gaussian(np.array([2.0, -1.0, 0.4]), cov, 20_000, rng).estimate
    offset = ellipse_points(located.pose, located.pose_cov) - located.pose[:2]
    distance = np.einsum("ij,jk,ik->i", offset, np.linalg.inv(located.pose_cov[:2, :2]), offset)
    np.testing.assert_allclose(distance, CHI2_95_2D, rtol=1e-9)


@pytest.mark.parametrize("camera", [CAMERA, CAMERA.ideal], ids=["lens", "pinhole"])
def test_predicted_lines_are_the_part_of_each_landmark_inside_the_image(camera: Camera) -> None:
    pose = np.array([0.1, -0.2, 0.05])
    view = Context("", camera, MAP)
    index, lines = predicted_lines(camera, pose, view.landmark_ends, np.ones(len(MAP), dtype=bool))
    assert list(index) == [0, 1, 2], "landmark 3 lies behind the camera"
    for landmark, line in zip(index, lines, strict=True):
        low, high = view.landmark_ends[landmark]
        heights = np.linspace(low[1], high[1], 2001)
        whole = camera.project(pose, np.array([[low[0], height, low[2]] for height in heights]))
        in_rows = whole[(whole[:, 1] >= 0) & (whole[:, 1] <= camera.height - 1)]
        # On the landmark's image, and reaching over all of it but a sliver at a border that lens and roll bend.
        assert all(np.linalg.norm(whole - point, axis=1).min() < 0.5 for point in line)
        assert np.ptp(line[:, 1]) > 0.85 * np.ptp(in_rows[:, 1])
        assert (np.diff(line[:, 1]) < 0).all()


def test_an_image_that_reaches_beyond_the_nadir_shows_lines() -> None:
    steep = CAMERA.ideal.with_mount(tilt_rad=np.deg2rad(75.0))
    ends = np.array([[[0.05, 0.0, -0.3], [0.05, 2.0, -0.3]]])
    index, lines = predicted_lines(steep, np.zeros(3), ends, np.ones(1, dtype=bool))
    assert list(index) == [0] and np.ptp(lines[0, :, 1]) > 20


@pytest.mark.parametrize("camera", [CAMERA, CAMERA.ideal], ids=["lens", "pinhole"])
def test_predicted_lines_stop_at_the_border_that_they_cross_sideways(camera: Camera) -> None:
    bearing = np.deg2rad(np.linspace(-40.0, 40.0, 161))
    landmarks = LandmarkMap.from_points(np.stack([np.sin(bearing), -np.cos(bearing)], axis=-1))
    pose = np.zeros(3)
    ends = Context("", camera, landmarks).landmark_ends
    index, lines = predicted_lines(camera, pose, ends, np.ones(len(landmarks), dtype=bool))
    size = np.array([camera.width, camera.height])
    assert ((lines >= -0.5) & (lines <= size - 0.5)).all()
    border = np.minimum(lines + 0.5, size - 0.5 - lines)[..., 0].min(axis=1)
    crossing = (border < 3.0) & (np.ptp(lines[..., 1], axis=1) > 20)
    assert crossing.sum() >= 2, "some of these lines leave the image at its left or right border"
    outside = np.setdiff1d(np.arange(len(landmarks)), index)
    whole = camera.project(pose, np.linspace(ends[outside, 0], ends[outside, 1], 400))
    inside = ((whole >= 5) & (whole <= size - 6)).all(axis=-1)
    assert not inside.any(), "what is left out is nowhere in the image"


def test_joins_lead_from_an_edges_middle_to_its_line_in_the_same_row() -> None:
    ends = np.array([[[10.0, 100.0], [14.0, 60.0]], [[50.0, 90.0], [50.0, 30.0]], [[70.0, 90.0], [70.0, 30.0]]])
    edges = Edges.from_columns(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), ends_px=ends)
    lines = np.array([[[20.0, 120.0], [30.0, 20.0]], [[0.0, 50.0], [0.0, 10.0]]])
    strips = joins(edges, np.array([7, -1, 5]), np.array([7, 2]), lines).strips
    np.testing.assert_allclose(strips.as_arrow_array().to_pylist(), [[[12.0, 80.0], [24.0, 80.0]]])


# -- the live view ----------------------------------------------------------------------------------------------------


def viewer(code: str, *arguments: object) -> list[str]:
    """A command that stands in for the viewer and gets the recording on its standard input."""
    return [sys.executable, "-c", f"import sys, time, os; {code}", *map(str, arguments)]


def show(sink: LiveView, count: int) -> None:
    for number in range(count):
        located, pose = frame(number)
        sink.frame(shown(located, picture(), pose, STAGE_MS))


def test_live_stream_is_the_recording(tmp_path: Path) -> None:
    sink = LiveView("native", context(), command=rerun("rrd", "merge", "-o", tmp_path / "live.rrd"))
    show(sink, FRAMES)
    sink.close(True)
    sink.wait()
    record(tmp_path / "run.rrd")
    assert read(tmp_path / "live.rrd") == read(tmp_path / "run.rrd")


def test_slow_viewer_misses_the_oldest_frames_and_gets_the_last(tmp_path: Path) -> None:
    go = tmp_path / "go"
    code = "[time.sleep(.01) for _ in iter(lambda: os.path.exists(sys.argv[1]), True)]; "
    code += "os.execv(sys.executable, sys.argv[2:])"
    command = viewer(code, go, *rerun("rrd", "merge", "-o", tmp_path / "live.rrd"))
    sink = LiveView("native", context(), command=command, queue_frames=4)
    show(sink, 30)
    go.touch()
    sink.close(True)
    sink.wait()
    frames = read(tmp_path / "live.rrd")[paths.ESS][paths.FRAME]
    assert frames == sorted(frames)
    assert frames[-1] == 29, "the newest frame is kept"
    assert len(frames) < 30, "a viewer that reads nothing cannot have got all"


def test_frozen_viewer_holds_up_neither_the_run_nor_the_exit(tmp_path: Path) -> None:
    """In a process of its own: Rerun's network sinks would block it at the exit, for ever."""
    script = tmp_path / "run.py"
    script.write_text(
        "import sys; sys.path[:0] = sys.argv[1:3]\n"
        "import test_view as t\n"
        "from localiser.view import viewer as live\n"
        "live.CLOSE_WAIT_S = 0.2\n"
        "sink = t.LiveView('native', t.context(), command=t.viewer('time.sleep(40)'), queue_frames=4)\n"
        "t.show(sink, 60)\n"
        "sink.close(True)\n"
        "print('done', sink.is_running, flush=True)\n"
    )
    here = Path(__file__).resolve().parent
    command = [sys.executable, str(script), str(here), str(here.parents[1])]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.split() == ["done", "True"]


@pytest.mark.parametrize(
    "command", [["/nonexistent/viewer"], [sys.executable, "-c", "pass"]], ids=["absent", "closes at once"]
)
def test_viewer_that_is_gone_ends_the_view_and_not_the_run(command: list[str]) -> None:
    sink = LiveView("native", context(), command=command, queue_frames=4)
    show(sink, 20)
    sink.close(True)
    sink.wait()
    assert not sink.is_running


@pytest.mark.parametrize("kind", ["native", "web"])
def test_viewers_listen_on_this_machine_alone(kind: Kind) -> None:
    command, address = viewer_command(kind)
    host = command[command.index("--bind") + 1]
    assert ip_address(host).is_loopback
    assert (address or f"http://{host}:").startswith(f"http://{host}:")
    assert command[-1] == "-", "the recording comes through standard input"


def test_viewers_elsewhere_are_served_where_the_user_says() -> None:
    command, address = viewer_command("0.0.0.0:9877")
    assert command[command.index("--bind") + 1 :][:1] == ["0.0.0.0"] and address == "rerun+http://0.0.0.0:9877/proxy"
    for wrong in ("somewhere", "0.0.0.0", "127.0.0.1:99999", "host name:1"):
        with pytest.raises(InputError, match="IP:PORT"):
            viewer_command(wrong)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere 127.0.0.1 may be the only address of this machine alone")
def test_the_address_of_the_page_cannot_be_guessed_by_pages_elsewhere() -> None:
    """A page that gives its own name one of our addresses must know which: names are not checked by Rerun."""
    hosts = {(viewer_command("web")[1] or "").split("/")[2].split(":")[0] for _ in range(20)}
    assert len(hosts) == 20 and "127.0.0.1" not in hosts


@pytest.mark.skipif(sys.platform != "linux", reason="processes as Linux lists them")
def test_a_viewer_does_not_outlive_a_run_that_is_killed() -> None:
    code = "import test_view as t; view = t.LiveView('web', t.context()); print(view._viewer.pid); input()"
    pipe, here = subprocess.PIPE, Path(__file__).parent
    with subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe, text=True, cwd=here) as run:
        group = int(run.stdout.readline())
        while len(processes_of(group)) < 2:  # the viewer, and what started it
            assert run.poll() is None
            time.sleep(0.05)
        run.kill()
    end = time.monotonic() + 60
    while processes_of(group):
        assert time.monotonic() < end
        time.sleep(0.05)


def processes_of(group: int) -> list[str]:
    """Return the processes of a group that run."""
    found = [one.read_text().rsplit(")", 1)[1].split() for one in Path("/proc").glob("[0-9]*/stat") if one.exists()]
    return [fields[0] for fields in found if int(fields[2]) == group and fields[0] != "Z"]
