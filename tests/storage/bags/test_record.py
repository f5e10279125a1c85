"""Bags that are written while things happen: what is promised of them when the program, or the disk, ends."""

from __future__ import annotations

from pathlib import Path

import pytest
from recorded_texts import MAKE, text, texts
from small_log import CAMERA, MAP, image

from localiser.errors import InputError, OutputError
from localiser.storage import open_log
from localiser.storage.bags import live_label_text
from localiser.storage.bags.database import BagRecorder
from localiser.storage.bags.write import image_decision, odometry_decision
from localiser.storage.images import encode_image

TEXT = "std_msgs/msg/String"


def test_messages_come_back_in_the_order_of_calls(tmp_path: Path) -> None:
    """Also when the calendar is set back in between."""
    recorder = BagRecorder(tmp_path / "a.db3")
    for k, t_ns in enumerate((100, 100, 50, 101, 3)):
        recorder.write("/a" if k % 2 else "/b", TEXT, t_ns, text(str(k)))
    recorder.close()
    assert texts(tmp_path / "a.db3") == list("01234")


def test_nothing_is_overwritten_and_other_kinds_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.db3").write_text("mine")
    with pytest.raises(OutputError, match="found something there"):
        BagRecorder(tmp_path / "a.db3")
    with pytest.raises(InputError, match=r"ends in \.db3"):
        BagRecorder(tmp_path / "a.mcap")


def test_decisions_leave_out_what_a_live_run_left_out(tmp_path: Path) -> None:
    recorder = BagRecorder(tmp_path / "a.db3")

    def send(topic: str, message: object) -> None:
        recorder.write(topic, message.__msgtype__, 1, MAKE.encode(message))

    send("/tf_static", MAKE.mount(0, CAMERA))
    send("/camera/camera_info", MAKE.camera_info(0, CAMERA))
    file = encode_image(image(0), ".jpg", 90)
    for k in range(6):
        pose = MAP.points[0][0] * k * 0.001, -0.1 * k, 0.0
        send("/odom", MAKE.odometry(k * 100, "odom", pose))
        send("/odom", MAKE.odometry(k * 100, "odom", (9.0, 9.0, 0.0)))
        send("/localiser/decisions", MAKE.text(odometry_decision(2 * k + 1, k * 100, "came twice")))
        send("/camera/image_raw/compressed", MAKE.compressed(k * 100, file))
        send("/localiser/decisions", MAKE.text(image_decision(k, k * 100, "" if k % 2 else "newer", by_wheels=k != 3)))
    recorder.close()
    log = open_log(tmp_path / "a.db3")
    assert [frame.t_ns for frame in log.frames] == [100, 300, 500]
    assert [frame.by_wheels for frame in log.frames] == [True, False, True]
    assert log.odometry.t_ns.tolist() == [k * 100 for k in range(6)] and abs(log.odometry.poses[:, 1]).max() < 1


def test_a_recording_says_which_topic_is_what(tmp_path: Path) -> None:
    """Also where names tell nothing, and where there are images that went out."""
    recorder = BagRecorder(tmp_path / "a.db3")

    def send(topic: str, message: object) -> None:
        recorder.write(topic, message.__msgtype__, 1, MAKE.encode(message))

    stated = {"image": "/front/compressed", "odometry": "/wheels", "groundtruth": "/mocap", "transforms": "/fixed"}
    send("/localiser/log", MAKE.text(live_label_text("a", {}, stated | {"camera_info": "/front/camera_info"})))
    send("/fixed", MAKE.mount(0, CAMERA))
    send("/front/camera_info", MAKE.camera_info(0, CAMERA))
    file = encode_image(image(0), ".jpg", 90)
    for k in range(3):
        send("/mocap", MAKE.odometry(k * 100, "map", (1.0, -0.1 * k, 0.0)))
        send("/wheels", MAKE.odometry(k * 100, "odom", (0.0, -0.1 * k, 0.0)))
        for topic in ("/front/compressed", "/shown/compressed", "/localiser/image/compressed"):
            send(topic, MAKE.compressed(k * 100, file))
        send("/localiser/decisions", MAKE.text(image_decision(k, k * 100)))
    recorder.close()
    log = open_log(tmp_path / "a.db3")
    assert len(log.frames) == 3 and log.odometry.poses[0, 0] == 0.0 and log.groundtruth.poses[0, 0] == 1.0
    assert open_log(tmp_path / "a.db3", topics={"odometry": "/mocap"}).odometry.poses[0, 0] == 1.0
