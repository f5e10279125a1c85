"""A replay as a bag: what other programs find in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from short_log import CORRIDOR, FRAMES, Localiser, cut_log

from localiser.geometry import compose
from localiser.storage import open_log, read_track
from localiser.storage.bags import stamp_of, typestore
from localiser.storage.bags.frames import FrameTree


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
