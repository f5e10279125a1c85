"""`localiser map`: from the command line to files, and every bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from folders import ROOT
from map_commands import edge_log, refused, run
from mapping_worlds import world
from short_log import cut_log

from localiser.edges import EdgeParameters, Edges
from localiser.mapping import edges_of_log
from localiser.storage import open_log, read_map, read_tum, write_tum

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
    assert len(landmark_map) > 50
    assert landmark_map.quality is not None
    assert np.isfinite(landmark_map.cov).all()
    assert f"{len(landmark_map)} landmarks" in built.output
    plain = run("map", "show", out, "-o", tmp_path / "plain.png")
    shown = run("map", "show", out, "--log", log)
    assert plain.exit_code == 0 and (tmp_path / "plain.png").read_bytes() != (tmp_path / "map.png").read_bytes()
    assert shown.exit_code == 0
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    assert "exists already" in refused("map", "show", out)


@pytest.mark.slow  # quick: tests/mapping/test_from_known_poses.py, and the command with other poses below
def test_poses_from_a_file_give_the_same_map_as_the_truth(tmp_path: Path) -> None:
    log = edge_log(tmp_path / "log", world("corridor").edges(seed=0)[:80])
    write_tum(world("corridor").truth, tmp_path / "poses.tum")
    for poses, name in (("truth", "a.yaml"), (tmp_path / "poses.tum", "b.yaml"), ("odometry", "c.yaml")):
        assert run("map", "build", log, "--poses", poses, "-o", tmp_path / name, "-q").exit_code == 0
    first, second, third = (read_map(tmp_path / name) for name in ("a.yaml", "b.yaml", "c.yaml"))
    assert second.points == pytest.approx(first.points, abs=1e-6)
    assert abs(len(third) - len(first)) <= 2  # this log's odometry is the truth, but less trusted while following


def test_a_log_alone_gives_a_map_and_a_trajectory(tmp_path: Path) -> None:
    drive = world("corridor")
    log = edge_log(tmp_path / "log", drive.edges(seed=0)[:60], truth=False)
    out, track = tmp_path / "map.yaml", tmp_path / "path.tum"
    built = run("map", "build", log, "--poses", "slam", "-o", out, "--trajectory", track)
    assert built.exit_code == 0
    assert "Wheels say" in built.output
    assert len(read_tum(track)) == 60
    # This log's odometry is the truth: what comes out must not be far from it.
    error = read_tum(track).poses - drive.truth.poses[:60]
    assert np.abs(error[:, :2]).max() < 0.1
    assert "exists already" in refused("map", "build", log, "-o", tmp_path / "b.yaml", "--trajectory", track)


def recorded(path: Path) -> dict[str, list[list[object]]]:
    """Return the rows of points, lines and numbers of every entity in a recording, in the order of frames."""
    from rerun.chunk import RrdReader

    rows: dict[str, list[list[object]]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if name.endswith((":positions", ":strips", ":scalars", ":text")):
                rows.setdefault(chunk.entity_path.removeprefix("/"), []).extend(column.to_pylist())
    return rows


def test_the_recording_shows_landmarks_that_grow_certain(tmp_path: Path) -> None:
    log = edge_log(tmp_path / "log", world("corridor").edges(seed=0)[:60])
    recording, out = tmp_path / "map.rrd", tmp_path / "map.yaml"
    assert run("map", "build", log, "-o", out, "--rrd", recording, "-q").exit_code == 0
    rows = recorded(recording)
    places, ellipses = rows["world/building/landmarks"], rows["world/building/ellipses"]
    assert len(places) == len(ellipses) == len(rows["world/camera/overlay/edges"]) + 1 == 61
    count = [len(row) for row in places[:-1]]
    assert count == sorted(count)
    assert count[-1] > 10 > count[0] == 0
    assert [row[0] for row in rows["plots/landmarks"]] == [len(row) for row in places]
    # Ellipses never grow, and shrink much, until all is refined at once.
    size = np.full((60, count[-1]), np.nan)
    for row, lines in zip(size, ellipses[:-1], strict=True):
        row[: len(lines)] = [np.ptp(np.array(line), axis=0).max() for line in lines]
    assert not (np.diff(size, axis=0) > 1e-6).any()
    assert np.median(size[-1] / np.nanmax(size, axis=0)) < 0.7
    # What is drawn last is what is in the file.
    drawn = np.array([line[0] for line in places[-1]])[:, [0, 2]]
    assert drawn == pytest.approx(read_map(out).points, abs=1e-3)
    assert "refined" in str(rows["text"][-1])
    assert "exists already" in refused("map", "build", log, "-o", tmp_path / "b.yaml", "--rrd", recording)


@pytest.mark.slow  # quick: the recording above
def test_the_recording_of_a_log_alone_shows_the_path_before_and_after_loops_were_closed(tmp_path: Path) -> None:
    log = edge_log(tmp_path / "log", world("corridor").edges(seed=0)[:60], truth=False)
    recording, track = tmp_path / "map.rrd", tmp_path / "path.tum"
    options = ("--poses", "slam", "--trajectory", track, "--rrd", recording, "-q")
    assert run("map", "build", log, "-o", tmp_path / "map.yaml", *options).exit_code == 0
    rows = recorded(recording)
    (before,), (after,) = rows["world/trails/before_loops"], rows["world/trails/after_loops"]
    assert np.array(after[0])[:, [0, 2]] == pytest.approx(read_tum(track).poses[:, :2], abs=1e-4)
    assert np.shape(before[0]) == np.shape(after[0])


@pytest.mark.slow  # quick: the recordings below have the same content
def test_a_build_can_be_watched_and_a_viewer_that_is_missing_is_no_obstacle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    from localiser.view import viewer

    log = edge_log(tmp_path / "log", world("corridor").edges(seed=0)[:60])
    code = "import sys, rerun_cli.__main__ as cli; sys.exit(cli.main())"
    shown, kept = tmp_path / "live.rrd", tmp_path / "file.rrd"
    command = [sys.executable, "-c", code, "rrd", "merge", "-o", str(shown)]
    monkeypatch.setattr(viewer, "viewer_command", lambda kind: (command, "http://here"))
    options = ("--view", "web", "--rrd", kept, "-q")
    watched = run("map", "build", log, "-o", tmp_path / "map.yaml", *options)
    assert watched.exit_code == 0
    assert "Watch at http://here" in watched.stderr
    assert recorded(shown) == recorded(kept)
    monkeypatch.setattr(viewer, "viewer_command", lambda kind: (["/no/such/viewer"], None))
    alone = run("map", "build", log, "-o", tmp_path / "b.yaml", "--view", "native", "-q")
    assert "without it" in alone.stderr
    assert read_map(tmp_path / "b.yaml").points == pytest.approx(read_map(tmp_path / "map.yaml").points)
    assert "native, web, none" in refused("map", "build", log, "-o", tmp_path / "c.yaml", "--view", "cinema")


def test_an_existing_map_is_not_overwritten_unasked(tmp_path: Path) -> None:
    log = edge_log(tmp_path / "log", world("corridor").edges(seed=0))
    out = tmp_path / "map.yaml"
    out.write_text("precious")
    assert "exists already" in refused("map", "build", log, "-o", out)
    assert out.read_text() == "precious"
    assert run("map", "build", log, "-o", out, "--force", "-q").exit_code == 0
    assert len(read_map(out)) > 50


@pytest.mark.parametrize("poses", ["truth", "nowhere.tum"])
def test_missing_poses_are_named(tmp_path: Path, poses: str) -> None:
    log = edge_log(tmp_path / "log", world("corridor").edges(seed=0), truth=False)
    message = refused("map", "build", log, "--poses", poses, "-o", tmp_path / "map.yaml")
    assert "poses" in message
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


def test_nothing_but_clutter_makes_no_map(tmp_path: Path) -> None:
    drive = world("corridor")
    clutter = [frame.take(frame.landmark_id < 0) for frame in drive.edges(seed=0, clutter=4.0)]
    log = edge_log(tmp_path / "log", clutter)
    assert "clutter" in refused("map", "build", log, "-o", tmp_path / "map.yaml")


def test_images_without_edges_make_no_map(tmp_path: Path) -> None:
    log = edge_log(tmp_path / "log", [Edges.none()] * 20)
    assert "found none in 20" in refused("map", "build", log, "-o", tmp_path / "map.yaml")


# -- the cache of edges -----------------------------------------------------------------------------------------------


def first_images(count: int):  # type: ignore[no-untyped-def]
    """Return the log of the corridor, cut to its first images."""
    from dataclasses import replace

    log = open_log(LOG)
    return replace(log, frames=log.frames[:count])


def test_a_second_build_finds_no_edges_anew(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = first_images(4)
    steps: list[int] = []
    first = edges_of_log(log, EdgeParameters(), lambda *_: steps.append(1), cache)

    def never(*_: object, **__: object) -> Edges:
        raise AssertionError("edges were found again")

    monkeypatch.setattr("localiser.mapping.recorded.find_edges", never)
    second = edges_of_log(log, EdgeParameters(), lambda *_: steps.append(1), cache)
    assert len(steps) == 8
    assert len(list(cache.iterdir())) == 1
    for one, other in zip(first, second, strict=True):
        for name in ("bearing", "lean_sigma", "polarity", "ends_px", "profile", "foot_range_m", "landmark_id"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        np.testing.assert_array_equal(one.common.cov, other.common.cov)
        np.testing.assert_array_equal(one.common.bearing_from_line, other.common.bearing_from_line)
        assert one.common.names == other.common.names
    with pytest.raises(AssertionError):
        edges_of_log(log, EdgeParameters(min_length_px=40.0), cache=cache)


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 broken"])
def test_a_broken_cache_is_made_anew(cache: Path, content: bytes) -> None:
    log = first_images(2)
    first = edges_of_log(log, EdgeParameters(), cache=cache)
    (kept,) = cache.iterdir()
    kept.write_bytes(content)
    second = edges_of_log(log, EdgeParameters(), cache=cache)
    np.testing.assert_array_equal(first[1].bearing, second[1].bearing)
    assert kept.stat().st_size > len(content)


def test_a_cache_that_cannot_be_written_is_no_obstacle(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    found = edges_of_log(first_images(2), EdgeParameters(), cache=blocked / "inside")
    assert len(found[0]) > 0


@pytest.mark.parametrize("poses", ["truth", "slam", "odometry"])
@pytest.mark.parametrize("content", ["clutter", "nothing", "few frames"])
def test_whatever_the_poses_a_log_of_nothing_makes_no_map(tmp_path: Path, poses: str, content: str) -> None:
    drive = world("corridor")
    edges = drive.edges(seed=0, clutter=4.0)[:40]
    if content == "clutter":
        edges = [frame.take(frame.landmark_id < 0) for frame in edges]
    elif content == "nothing":
        edges = [Edges.none()] * 40
    else:
        edges = edges[:4]
    log, folder = edge_log(tmp_path / "log", edges), tmp_path / "out"
    folder.mkdir()
    (folder / "old.rrd").write_text("precious")
    files = ("-o", folder / "map.yaml", "--trajectory", folder / "path.tum", "--rrd", folder / "old.rrd", "--force")
    assert "expected" in refused("map", "build", log, "--poses", poses, *files)
    assert [path.name for path in folder.iterdir()] == ["old.rrd"]
    assert (folder / "old.rrd").read_text() == "precious"


@pytest.mark.data
@pytest.mark.slow  # quick: tests/replay/test_bag.py names topics
def test_a_bag_whose_topics_are_named_is_mapped(data_dir: Path, tmp_path: Path) -> None:
    bag, out = data_dir / "house_bag", tmp_path / "map.yaml"
    assert "/none" in refused("map", "build", bag, "-o", out, "--topic", "odometry=/none")
    assert not out.exists()
    assert run("map", "build", bag, "-o", out, "--topic", "odometry=/odom", "-q").exit_code == 0
    assert len(read_map(out)) > 20


@pytest.mark.parametrize(("tilt_deg", "warned"), [pytest.param("20.0", False, marks=pytest.mark.slow), ("22.0", True)])
def test_a_wrong_tilt_is_told_before_the_map_is_saved(tmp_path: Path, tilt_deg: str, warned: bool) -> None:
    log = cut_log(LOG, tmp_path / "log", 40)
    camera = log / "camera.yaml"
    assert "tilt_deg: 20.0" in camera.read_text()
    camera.write_text(camera.read_text().replace("tilt_deg: 20.0", f"tilt_deg: {tilt_deg}"))
    built = run("map", "build", log, "-o", tmp_path / "map.yaml", "-q")
    assert built.exit_code == 0
    assert (f"stated are {tilt_deg}0° and 1.00°. See `localiser camera tilt" in built.output) == warned
