"""`localiser map`: from the command line to files, and every bad input."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from far_room import CAMERA, far_poses, images, room
from folders import ROOT
from map_commands import edge_log, refused, run
from mapping_worlds import world
from short_log import cut_log

from localiser.camera import Camera, RollingShutter
from localiser.config import read_config
from localiser.edges import CommonError, EdgeParameters, Edges
from localiser.errors import InputError
from localiser.filter import Sighting
from localiser.geometry import Trajectory, compose, private_folder
from localiser.mapping import edges_of_log
from localiser.mapping import recorded as recorded_log
from localiser.replay import prepare
from localiser.replay.run import start_of
from localiser.storage import open_log, read_map, read_poses, write_log, write_tum

LOG = ROOT / "logs" / "corridor"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Keep the edges of every test apart from the user's."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("LOCALISER_CACHE", str(folder))
    return folder


@pytest.mark.slow
def test_build_and_show(tmp_path: Path) -> None:
    log = edge_log(tmp_path / "log", world("corridor").edges(seed=0))
    out = tmp_path / "map.yaml"
    built = run("map", "build", log, "--poses", "truth", "-o", out)
    assert built.exit_code == 0
    landmark_map = read_map(out)
    assert len(landmark_map) > 50 and landmark_map.quality is not None and np.isfinite(landmark_map.cov).all()
    assert f"{len(landmark_map)} landmarks" in built.output
    assert run("map", "show", out, "-o", tmp_path / "plain.png").exit_code == 0
    assert "expected a new file" in refused("map", "show", out, "-o", tmp_path / "plain.png")
    for _ in range(2):  # a picture under its own name takes the place of the one before
        shown = run("map", "show", out, "--path", log)
        assert shown.exit_code == 0 and f"Picture in {tmp_path / 'map_map.png'}" in shown.output.replace("\n", "")
    assert (tmp_path / "plain.png").read_bytes() != (tmp_path / "map_map.png").read_bytes()


def test_a_log_alone_gives_a_map_and_a_trajectory(tmp_path: Path) -> None:
    drive = world("corridor")
    log = edge_log(tmp_path / "log", drive.edges(seed=0)[:60], truth=False)
    out, track = tmp_path / "map.yaml", tmp_path / "path.tum"
    built = run("map", "build", log, "-o", out, "--trajectory", track)
    assert built.exit_code == 0
    assert f"{log} has no truth: where the robot was is found from the log alone" in built.output
    assert "Wheels say" in built.output
    assert set(read_map(out).source) == {"drive, poses: slam"}
    assert len(read_poses(track)) == 60
    # This log's odometry is the truth: what comes out must not be far from it.
    error = read_poses(track).poses - drive.truth.poses[:60]
    assert np.abs(error[:, :2]).max() < 0.1
    new = tmp_path / "b.yaml"
    assert "expected a new file" in refused("map", "build", log, "-o", new, "--trajectory", track)
    assert "--trajectory: expected another file" in refused("map", "build", log, "-o", new, "--trajectory", new)


def test_the_drive_of_a_map_starts_where_it_began_and_another_is_looked_for(tmp_path: Path) -> None:
    """Whatever the frame: here the map has that of a trajectory from elsewhere."""
    drive, rng = world("corridor"), np.random.default_rng(0)
    edges = drive.edges(seed=0)
    log, out = edge_log(tmp_path / "log", edges, truth=False), tmp_path / "map.yaml"
    moved = Trajectory(drive.truth.t_ns, compose(np.array([5.0, -3.0, 1.0]), drive.truth.poses))
    write_tum(moved, tmp_path / "slam")  # a file of that name, not the word
    built = run("map", "build", log, "--poses", tmp_path / "slam", "-o", out)
    assert built.exit_code == 0 and "Wheels say" not in built.output
    recorded, landmark_map = open_log(log), read_map(out)
    start = start_of(recorded, None, rng, landmark_map)
    assert start.mean == pytest.approx(moved.poses[0], abs=1e-6)
    assert start.t_ns == recorded.frames[0].t_ns
    assert np.linalg.norm(prepare(recorded, read_config(None), landmark_map=landmark_map).start.mean - start.mean) == 0
    assert start_of(recorded, "global", rng, landmark_map) is None
    assert start_of(replace(recorded, frames=recorded.frames[1:]), None, rng, landmark_map) is None
    other = replace(recorded, odometry=Trajectory(recorded.odometry.t_ns, 1.1 * recorded.odometry.poses))
    assert start_of(other, None, rng, landmark_map) is None
    # Moved to another frame, the map no longer says where that is.
    assert run("map", "align", out, out, "-o", tmp_path / "b.yaml").exit_code == 0
    assert start_of(recorded, None, rng, read_map(tmp_path / "b.yaml")) is None
    out.write_text(out.read_text().replace("odometry_m: ", "odometry_m: far #"))
    with pytest.raises(InputError, match=r"map.yaml:\d+.*odometry_m"):
        read_map(out)


@pytest.mark.parametrize("poses", ["truth", "nowhere.tum"])
def test_missing_poses_are_named(tmp_path: Path, poses: str) -> None:
    log = edge_log(tmp_path / "log", world("corridor").edges(seed=0), truth=False)
    assert "poses" in refused("map", "build", log, "--poses", poses, "-o", tmp_path / "map.yaml")
    assert not (tmp_path / "map.yaml").exists()


def test_a_robot_that_stands_still_makes_no_map(tmp_path: Path) -> None:
    drive = world("corridor")
    edges = drive.edges(seed=0)
    log = edge_log(tmp_path / "log", [edges[0]] * 40, np.tile(drive.truth.poses[0], (40, 1)))
    assert "expected a robot that drives" in refused("map", "build", log, "-o", tmp_path / "map.yaml")


@pytest.mark.parametrize("frames", [6, 8], ids=["of all", "of most"])
def test_too_little_parallax_is_said(tmp_path: Path, frames: int) -> None:
    log = edge_log(tmp_path / "log", world("corridor").edges(seed=0, clutter=0.0), frames=frames)
    message = refused("map", "build", log, "-o", tmp_path / "map.yaml")
    assert "parallax" in message
    assert "°" in message


# -- the cache of edges -----------------------------------------------------------------------------------------------


def first_images(count: int):  # type: ignore[no-untyped-def]
    """Return the log of the corridor, cut to its first images."""
    log = open_log(LOG)
    return replace(log, frames=log.frames[:count])


def same(one: Edges, other: Edges) -> bool:
    """Whether edges are the same to the last bit, with the errors that they share."""
    pairs = ((getattr(one, field.name), getattr(other, field.name)) for field in fields(Edges))
    shared = ((getattr(one.common, field.name), getattr(other.common, field.name)) for field in fields(CommonError))
    return all(
        np.array_equal(a, b, equal_nan=True) if isinstance(a, np.ndarray) and a.dtype.kind == "f" else np.all(a == b)
        for a, b in (*pairs, *shared)
        if not isinstance(a, CommonError)
    )


def test_a_second_build_finds_no_edges_anew(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, kept = first_images(4), private_folder("edges")
    steps: list[int] = []
    first = edges_of_log(log, EdgeParameters(), lambda: steps.append(1), kept)

    def never(*_: object, **__: object) -> Edges:
        raise AssertionError("edges were found again")

    monkeypatch.setattr("localiser.mapping.recorded.find_edges", never)
    second = edges_of_log(log, EdgeParameters(), lambda: steps.append(1), kept)
    assert len(steps) == 8 and len(list((cache / "edges").iterdir())) == 1
    assert all(same(one, other) for one, other in zip(first, second, strict=True))
    with pytest.raises(AssertionError):
        edges_of_log(log, EdgeParameters(min_length_px=40.0), cache=kept)


@pytest.mark.parametrize("content", [b"", b"short", b"0" * 2000])
def test_edges_that_were_damaged_are_found_anew(cache: Path, content: bytes) -> None:
    log, folder = first_images(2), private_folder("edges")
    first = edges_of_log(log, EdgeParameters(), cache=folder)
    (kept,) = (cache / "edges").iterdir()
    kept.write_bytes(content)
    second = edges_of_log(log, EdgeParameters(), cache=folder)
    assert all(same(one, other) for one, other in zip(first, second, strict=True))
    assert kept.stat().st_size > len(content)


def test_edges_are_found_once_where_nothing_can_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And also where no map comes out, and the clocks are compared to say why."""
    log, found = cut_log(LOG, tmp_path / "log", 40), []
    plain = recorded_log.find_edges
    monkeypatch.setattr(recorded_log, "find_edges", lambda *a, **k: found.append(1) or plain(*a, **k))
    monkeypatch.setattr("localiser.geometry.private_folder", lambda name: None)
    assert run("map", "build", log, "-o", tmp_path / "map.yaml", "-q").exit_code == 0
    assert len(found) == 40
    refused("map", "build", log, "-o", tmp_path / "b.yaml", "-q", "--set", "mapping.sightings_min=41")
    assert len(found) == 80


def test_edges_of_a_rolling_shutter_are_kept_by_how_the_robot_moved(cache: Path) -> None:
    log, parameters = first_images(2), EdgeParameters()
    rolling = replace(log, camera=replace(log.camera, shutter=RollingShutter(600e-6)))
    turning = Trajectory(log.odometry.t_ns, log.odometry.poses + np.outer(log.odometry.t_ns / 1e9, [0.0, 0.0, 1.0]))
    for each in (log, rolling, replace(rolling, odometry=turning), rolling):
        edges_of_log(each, parameters, cache=private_folder("edges"))
    assert len(list((cache / "edges").iterdir())) == 3


# -- what makes no map ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("poses", ["truth", "slam", "odometry"])
@pytest.mark.parametrize("content", ["clutter", "nothing", "few frames", "flashes"])
def test_whatever_the_poses_a_log_of_nothing_makes_no_map(tmp_path: Path, poses: str, content: str) -> None:
    drive = world("corridor")
    edges = drive.edges(seed=0, clutter=4.0)[:40]
    edges = {
        "clutter": [frame.take(frame.landmark_id < 0) for frame in edges],
        "nothing": [Edges.none()] * 40,
        "flashes": [frame.take(np.arange(t % 15 == 0)) for t, frame in enumerate(edges)],
        "few frames": edges[:4],
    }[content]
    log, folder = edge_log(tmp_path / "log", edges), tmp_path / "out"
    folder.mkdir()
    files = ("-o", folder / "map.yaml", "--trajectory", folder / "path.tum")
    assert "expected" in refused("map", "build", log, "--poses", poses, *files)
    assert not list(folder.iterdir())


@pytest.mark.parametrize(("tilt_deg", "warned"), [pytest.param("20.0", False, marks=pytest.mark.slow), ("22.0", True)])
def test_a_wrong_tilt_is_told_before_the_map_is_saved(tmp_path: Path, tilt_deg: str, warned: bool) -> None:
    log = cut_log(LOG, tmp_path / "log", 40)
    camera = log / "camera.yaml"
    assert "tilt_deg: 20.0" in camera.read_text()
    camera.write_text(camera.read_text().replace("tilt_deg: 20.0", f"tilt_deg: {tilt_deg}"))
    built = run("map", "build", log, "-o", tmp_path / "map.yaml", "-q")
    assert built.exit_code == 0
    assert (f"stated are {tilt_deg}0° and 1.00°. See `localiser camera tilt" in built.output) == warned


OTHER = replace(CAMERA, fx=500.0, fy=500.0, mount=replace(CAMERA.mount, right_m=0.1, height_m=1.2))


def room_log(folder: Path, camera: Camera, seed: int) -> Path:
    """Write a log of edges in 45 images that are far apart in one room."""
    poses = far_poses(45, seed)
    edges = images(*room(0), poses, seed + 1, clutter=2, camera=camera)
    track = Trajectory(np.arange(45, dtype=np.int64) * 10**9, poses)
    sightings = [Sighting(int(t_ns), edge) for t_ns, edge in zip(track.t_ns, edges, strict=True)]
    write_log(folder, name=folder.name, camera=camera, odometry=track, sightings=sightings, groundtruth=track)
    return folder


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("room")
    return room_log(folder / "monday", CAMERA, 1), room_log(folder / "tuesday", OTHER, 11)


def test_two_cameras_on_two_days_make_one_map(logs: tuple[Path, Path], tmp_path: Path) -> None:
    found = []
    for names in (logs[:1], logs):
        built = run("map", "build", *names, "--poses", "truth", "-o", tmp_path / f"{len(names)}.yaml", "-q")
        assert built.exit_code == 0
        landmark_map = read_map(tmp_path / f"{len(names)}.yaml")
        apart = np.linalg.norm(landmark_map.points[:, None] - room(0)[0][None], axis=-1)
        assert (apart.min(axis=1) < 0.06).mean() > 0.9
        found.append(int((apart.min(axis=0) < 0.03).sum()))
    assert found[1] > found[0]
    assert found[1] >= 18
    assert set(landmark_map.source) == {"monday + tuesday, poses: truth"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--poses", "odometry"), "must share one frame"),
        (("--poses", "slam"), "must share one frame"),
        (("--trajectory", "path.tum"), "--trajectory"),
    ],
)
def test_several_logs_need_their_truth_and_write_no_path(logs, tmp_path, options, message):
    out = tmp_path / "map.yaml"
    options = tuple(str(tmp_path / word) if word.endswith(".tum") else word for word in options)
    assert message in refused("map", "build", *logs, "-o", out, *options)
    assert not out.exists()
