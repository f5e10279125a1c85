"""A replay as a bag; what it warns of; and logs whose clock or wheels jump."""

import csv
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from short_log import CORRIDOR, FRAMES, Localiser, cut_log

from localiser.geometry import compose
from localiser.storage import open_log, read_track
from localiser.storage.bags import stamp_of, typestore
from localiser.storage.bags.transforms import FrameTree


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return a short log and the folder of its run, with `out.mcap` beside."""
    from localiser.config import read_config
    from localiser.replay import FolderRun, Outputs
    from localiser.replay.run import prepare

    folder = tmp_path_factory.mktemp("bag")
    log = open_log(cut_log(CORRIDOR, folder / "corridor", FRAMES))
    config = read_config(None, ["mcl.particles=300", "mcl.start_particles=1000"], log.settings)
    outputs = Outputs(folder / "results", rrd=False, report=False, bag=folder / "out.mcap")
    run = FolderRun.open(prepare(log, config, None), outputs)
    run.run(lambda: None)
    return folder / "corridor", run.folder.path


def messages_of(bag: Path) -> list[tuple[str, str, int, Any]]:
    """Return topic, type, time and message, read by rosbags alone."""
    with AnyReader([bag], default_typestore=typestore(ros1=False)) as reader:
        return [
            (connection.topic, connection.msgtype, t_ns, reader.deserialize(data, connection.msgtype))
            for connection, t_ns, data in reader.messages()
        ]


def test_transforms_lead_from_the_map_to_the_robot_at_every_pose(written: tuple[Path, Path]) -> None:
    """And so to the camera: at an image, map → base is the pose that was located."""
    folder, run = written
    log, track = open_log(folder), read_track(run / "trajectory.csv")
    at: dict[tuple[str, int], Any] = {}
    for topic, _, t_ns, message in messages_of(run.parents[2] / "out.mcap"):
        if topic == "/tf":
            (stamped,) = message.transforms
            assert stamp_of(stamped) == t_ns
            at[stamped.header.frame_id, t_ns] = message.transforms
    first = log.frames[0].t_ns
    wheels = [int(t_ns) for t_ns in log.odometry.t_ns]
    assert all(("odom", t_ns) in at and (("map", t_ns) in at or t_ns <= first) for t_ns in wheels)
    for t_ns, pose in zip(track.t_ns.tolist(), track.poses, strict=True):
        tree = FrameTree()
        tree.add_all(at["map", t_ns])
        map_from_odom = tree.between("map", "odom")
        yaw = np.arctan2(map_from_odom[1, 0], map_from_odom[0, 0])
        moved = np.array([map_from_odom[0, 3], -map_from_odom[1, 3], yaw])
        np.testing.assert_allclose(compose(moved, log.odometry.at(t_ns)), pose, atol=1e-6)


def test_the_bag_is_a_log_again(written: tuple[Path, Path]) -> None:
    folder, run = written
    log, again = open_log(folder), open_log(run.parents[2] / "out.mcap")
    assert [frame.encoded() for frame in again.frames] == [frame.encoded() for frame in log.frames]
    np.testing.assert_array_equal(again.odometry.t_ns, log.odometry.t_ns)
    assert again.landmark_map is not None and again.groundtruth is not None


def test_a_bag_that_cannot_be_written_is_told_before_the_run(localiser: Localiser, tmp_path: Path) -> None:
    (tmp_path / "there.mcap").write_text("mine")
    for name, told in (("there.mcap", "expected a new file"), ("out.bag", "ends in .mcap or .db3")):
        result = localiser("replay", CORRIDOR, "--out", tmp_path / "results", "--bag", tmp_path / name, "--quiet")
        assert result.exit_code != 0 and told in result.err
    assert not (tmp_path / "results").exists() and (tmp_path / "there.mcap").read_text() == "mine"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return cut_log(CORRIDOR, tmp_path / "log", FRAMES)


def figures_of(localiser: Localiser, log: Path, out: Path) -> dict:
    return json.loads((localiser.replay(log, out) / "metrics.json").read_text())


@pytest.mark.parametrize(("gain", "said"), [(0.2, "are dark: 95 %"), (3.0, "are washed out:")])
def test_bad_light_is_told(localiser: Localiser, log: Path, tmp_path: Path, gain: float, said: str) -> None:
    for path in (log / "images").iterdir():
        image = np.clip(gain * cv2.imread(str(path)), 0, 255).astype(np.uint8)
        cv2.imwrite(str(path), image)
    figures = figures_of(localiser, log, tmp_path / "out")
    (warning,) = [text for text in figures["warnings"] if said in text]
    assert warning.startswith("3 of 3 images looked at"), "every fifth"


def test_silent_odometry_is_told_and_a_plain_log_has_no_warning(localiser, log, tmp_path):
    plain = figures_of(localiser, log, tmp_path / "plain")
    assert plain["warnings"] == []
    header, *rows = (log / "odometry.csv").read_text().splitlines()
    kept = [row for row in rows if not 400_000_000 < int(row.split(",")[0]) < 1_900_000_000]
    (log / "odometry.csv").write_text("\n".join([header, *kept]) + "\n")
    silent = figures_of(localiser, log, tmp_path / "silent")
    (warning,) = silent["warnings"]
    assert "silent for more than 1 s 1×, for 1.5 s in all, in which 8 images came" in warning
    assert "after 0.4 s" in warning


DECADES_NS = 30 * 365 * 86_400 * 10**9
JUMP_NS = 1_000_000_000
TABLES = ("images.csv", "odometry.csv", "groundtruth.csv")


def jumped_log(folder: Path, column: str, jump: float) -> Path:
    """Return a log in which a column of all tables that have it is greater by `jump` after some images."""
    log = cut_log(CORRIDOR, folder, 12)
    for name in TABLES:
        with (log / name).open(newline="") as file:
            rows = list(csv.DictReader(file))
        if column in rows[0]:
            for row in rows:
                if int(row["t_ns"]) > JUMP_NS:
                    row[column] = str(type(jump)(row[column]) + jump)
            lines = [",".join(rows[0]), *(",".join(row.values()) for row in rows)]
            (log / name).write_text("\n".join(lines) + "\n")
    return log


@pytest.mark.parametrize("odometry", [pytest.param("wheel", marks=pytest.mark.slow), "vision"])
def test_a_calendar_that_jumps_by_decades_takes_no_longer(localiser: Localiser, tmp_path: Path, odometry: str) -> None:
    log = jumped_log(tmp_path / "log", "t_ns", DECADES_NS)
    run = localiser.replay(log, tmp_path / "out", "--odometry", odometry)
    assert json.loads((run / "metrics.json").read_text())["frames"] == 12


def test_wheels_that_jump_around_the_world_are_survived(localiser: Localiser, tmp_path: Path) -> None:
    log = jumped_log(tmp_path / "log", "x", 9e8)
    run = localiser.replay(log, tmp_path / "out", "--start", "0.11,0.60,1.2")
    assert json.loads((run / "metrics.json").read_text())["frames"] == 12
