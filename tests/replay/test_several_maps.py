"""Several maps in one belief, end to end: which floor, and poses in its frame."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader
from rosbags.highlevel import AnyReader
from short_log import CORRIDOR, Localiser, cut_log

from localiser import documents
from localiser.errors import InputError
from localiser.landmarks import LandmarkMap
from localiser.replay import replay_log
from localiser.storage import Site, checkpoint_of, map_text, open_log, read_map, read_maps, write_map
from localiser.view import paths

LOG = open_log(CORRIDOR)
MAP = LOG.landmark_map
SHIFT = np.array([7.0, -3.0])
N = 10


def floors() -> list[LandmarkMap]:
    """Return two floors of one plan, furnished differently; the log is of the first, whose frame lies elsewhere."""
    rng = np.random.default_rng(1)
    other = MAP.points + np.where(rng.random((len(MAP), 1)) < 0.4, rng.normal(0.0, 1.0, MAP.points.shape), 0.0)
    return [replace(MAP, name="ground", points=MAP.points + SHIFT), replace(MAP, name="first", points=other)]


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    paths = [tmp_path / "maps" / f"{one.name}.yaml" for one in floors()]
    paths[0].parent.mkdir()
    for one, path in zip(floors(), paths, strict=True):
        write_map(replace(one, name="drive"), path)  # a map is called as its file is
    return paths


@pytest.mark.parametrize("first", [0, 1])
def test_the_floor_is_found_and_poses_are_in_its_frame(localiser, files, tmp_path, first):
    """Whichever is named first. All that is written says on which map: table, recording, bag."""
    log, bag = cut_log(CORRIDOR, tmp_path / "log", N), tmp_path / "out.mcap"
    maps = ["--map", files[first], "--map", files[1 - first]]
    options = ["--start", "global", "--bag", bag]
    run = localiser.replay(log, tmp_path / "out", *maps, *options, rrd=True)
    rows = list(csv.DictReader((run / "trajectory.csv").open()))
    last = rows[-1]
    assert last["map"] == "ground" and float(last["p_correct"]) > 0.9
    truth = LOG.groundtruth.at(int(last["t_ns"]))
    assert np.hypot(float(last["x"]) - truth[0] - SHIFT[0], float(last["z"]) - truth[1] - SHIFT[1]) < 0.05
    assert documents.load(run / "run.yaml").value["map"]["path"].count(",") == 1

    chunks = [chunk for chunk in RrdReader(run / "run.rrd").stream() if chunk.entity_path == f"/{paths.LANDMARKS}"]
    drawn = np.concatenate([np.array(strip.as_py()) for strip in _lines(chunks)[-1]])
    assert np.abs(drawn[:, [0, 2]] - MAP.points.mean(axis=0) - SHIFT).max() < 20, "the map that is believed, alone"
    assert {path.suffix for path in tmp_path.iterdir()} >= {".rviz", ".json"}, "layouts"
    assert [one.name for one in open_log(bag).landmark_map.maps] == [files[first].stem, files[1 - first].stem]
    with AnyReader([bag]) as reader:
        read = [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]
    poses = [message for topic, message in read if topic == "/localiser/pose"]
    assert poses[-1].header.frame_id == "map_ground"
    assert poses[-1].pose.pose.position.x == pytest.approx(float(last["x"]), abs=1e-6)
    frames = [one.header.frame_id for topic, message in read if topic == "/tf" for one in message.transforms]
    assert "map_ground" in frames and "map" not in frames
    assert [m.markers[0].header.frame_id for topic, m in read if topic == "/localiser/landmarks"][-1] == "map_ground"


def _lines(chunks: list) -> list:
    """Return the strips of every row that has any."""
    rows = []
    for chunk in chunks:
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if name.endswith("strips")]
        rows += [row for name in names for row in batch[name] if row.is_valid and len(row)]
    return rows


def test_a_start_is_on_the_map_that_it_names(localiser: Localiser, files: list[Path], tmp_path: Path) -> None:
    log = cut_log(CORRIDOR, tmp_path / "log", 4)
    x, z, heading = LOG.groundtruth.at(LOG.frames[0].t_ns)
    start = f"ground:{x + SHIFT[0]:.3f},{z + SHIFT[1]:.3f},{np.rad2deg(heading):.2f}"
    maps = ["--map", files[1], "--map", files[0]]
    run = localiser.replay(log, tmp_path / "out", *maps, "--start", start)
    assert {row["map"] for row in csv.DictReader((run / "trajectory.csv").open())} == {"ground"}
    said = localiser("replay", log, *maps, "--start", f"cellar:{x},{z},0", "--out", tmp_path / "none").err
    assert "expected one of first, ground, found 'cellar'" in said
    assert "no name of a map" in localiser("replay", log, "--start", start, "--out", tmp_path / "none").err


def test_a_list_of_maps_is_the_same_as_naming_them(files: list[Path]) -> None:
    site = files[0].parent / "site.yaml"
    site.write_text("format: localiser-site/1\nname: house\nmaps: [ground.yaml, first.yaml]\n")
    named, listed = read_maps(files), read_map(site)
    assert isinstance(listed, Site) and [one.name for one in listed.maps] == ["ground", "first"]
    np.testing.assert_array_equal(named.points, listed.points)
    (files[0].parent / "whole.yaml").write_text(map_text(named))
    whole = read_map(files[0].parent / "whole.yaml")
    np.testing.assert_array_equal(whole.points, named.points)
    assert whole.ids == named.ids and whole.maps[1].ids == MAP.ids


def test_where_a_robot_begins_on_the_map_of_its_own_drive_is_known(files: list[Path]) -> None:
    """It is that drive's map among several, whichever it is."""
    first, last = LOG.frames[0].t_ns, LOG.frames[-1].t_ns
    driven = float(np.hypot(*np.diff(LOG.odometry.poses[:, :2], axis=0).T).sum())
    drive = {"log": "x", "first_image_ns": first, "last_image_ns": last, "odometry_m": driven}
    own, other = floors()
    own = replace(own, header={"drive": drive | {"start": {"x": 7.1, "z": -2.3, "heading_deg": 3.0}}})
    run = replay_log(replace(LOG, start=None, frames=LOG.frames[:1]), landmark_map=Site.beside([other, own]))
    assert run.start is None, "not all of the drive"
    from localiser.replay import prepare

    ready = prepare(replace(LOG, start=None), run.localiser.config, landmark_map=(site := Site.beside([other, own])))
    np.testing.assert_allclose(ready.start.mean - site.origin("ground"), [7.1, -2.3, np.deg2rad(3.0)])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("maps: [ground.yaml, ground.yaml]", "maps: expected maps with a name of their own, found 'ground' 2×"),
        ("maps: [../ground.yaml]", "maps[0]: expected a path inside"),
        ("maps: [site.yaml]", "site.yaml:1:1: format: expected 'localiser-map/1'"),
        ("maps: []", "maps: expected"),
        ("maps: [{format: localiser-map/1, landmarks: [{id: 1, x: 0}]}]", "2:46: landmarks[0].z: expected"),
        ("maps: [{format: localiser-site/1, maps: []}]", "maps[0].format: expected 'localiser-map/1'"),
        ("floors: []", "floors: unknown key"),
    ],
)
def test_a_list_that_cannot_be_is_refused(files: list[Path], text: str, problem: str) -> None:
    site = files[0].parent / "site.yaml"
    site.write_text(f"format: localiser-site/1\n{text}\n")
    with pytest.raises(InputError) as error:
        read_map(site)
    assert problem in str(error.value)


def test_maps_stand_farther_apart_than_anything_is_seen() -> None:
    maps = [replace(one, name=str(k)) for k, one in enumerate(floors() * 2)]
    site = Site.beside(maps)
    for number, one in enumerate(maps):
        on = site.points - site.origin(one.name)[:2]
        here = on[number * len(MAP) : (number + 1) * len(MAP)]
        np.testing.assert_allclose(here, one.points, rtol=0, atol=1e-12)
        others = np.delete(on, np.s_[number * len(MAP) : (number + 1) * len(MAP)], axis=0)
        assert np.hypot(*(others[:, None] - here[None]).T).min() >= 60
        assert site.is_on(one.name, here).all() and not site.is_on(one.name, others).any()
        assert {site.map_at(point) for point in here + site.origin(one.name)[:2]} == {one.name}
    assert site.origin("0").tolist() == [0, 0, 0], "the first keeps its coordinates"


def test_a_state_goes_on_with_the_same_maps(files: list[Path]) -> None:
    """To the last bit, as with one map; with others it is refused."""
    site = read_maps(files)
    run = replay_log(replace(LOG, frames=LOG.frames[:4]), landmark_map=site, start="global")
    state = run.localiser.save()
    again = replay_log(replace(LOG, frames=LOG.frames[:1]), landmark_map=read_maps(files), start="global").localiser
    again.restore(state)
    assert checkpoint_of(again.save(), Path("a")).identity == run.localiser.identity
    one = replay_log(replace(LOG, frames=LOG.frames[:1]), landmark_map=read_maps(files[::-1]), start="global").localiser
    with pytest.raises(InputError, match="map: expected"):
        one.restore(state)


@pytest.mark.slow
def test_a_robot_that_comes_to_another_map_is_found_there() -> None:
    """The corridor's two legs are two maps with frames of their own: the robot leaves one and enters the other."""
    first = MAP.points[:, 1] > -9.0
    legs = [MAP.take(np.flatnonzero(first)), MAP.take(np.flatnonzero(~first))]
    legs = [replace(legs[0], name="long"), replace(legs[1], name="short", points=legs[1].points + SHIFT)]
    run = replay_log(LOG, landmark_map=Site.beside(legs))
    names, sure = [one.map_name for one in run.frames], [one.located.p_correct > 0.9 for one in run.frames]
    assert names[0] == "long" and sure[20]
    assert names[-1] == "short" and sure[-1]
    truth = LOG.groundtruth.at(run.frames[-1].located.t_ns)
    assert np.hypot(*(run.frames[-1].located.estimate.pose - truth)[:2] - SHIFT) < 0.1
    crossed = names.index("short")
    assert not any(s and n == "long" for s, n in zip(sure[crossed:], names[crossed:], strict=True))
