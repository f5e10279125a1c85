"""What a live run says while it runs, and the table at its end; the stand-in for a robot."""

from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from threading import Event
from unittest.mock import patch

import cv2
import numpy as np
import pytest
from live_feed import LOG, Feed, camera, drive, image
from live_transport import KeepingTransport
from rich.console import Console
from short_log import CORRIDOR, Localiser
from small_log import write_edge_log, write_small_log

from localiser.commands.live import end_table
from localiser.config import read_config
from localiser.errors import InputError
from localiser.geometry import Increment, between, compose
from localiser.live import LiveOptions, status_line
from localiser.live.monitor import Monitor
from localiser.live.prepare import advice
from localiser.live.stand_in import FIXED, IMAGE, INFO, MOVING, WHEELS, Passage, StandIn
from localiser.storage import open_log
from localiser.storage.bags.transforms import FrameTree, mount_of


@pytest.fixture
def said() -> list[tuple[str, str]]:
    return []


@pytest.fixture
def monitor(said: list[tuple[str, str]]) -> Monitor:
    return Monitor(lambda text, level: said.append((text, level)))


def at(seconds: float) -> AbstractContextManager[object]:
    return patch("localiser.live.monitor.time.monotonic", return_value=seconds)


def test_nothing_alarming_while_the_first_message_is_awaited(monitor: Monitor, said: list[tuple[str, str]]) -> None:
    for seconds in (100.0, 100.5, 104.0):
        with at(seconds):
            monitor.watch(("image", "odometry"))
    assert said == [] and monitor.heard_nothing
    for seconds in (105.5, 150.0):
        with at(seconds):
            monitor.watch(("image", "odometry"))
    assert said == [("nothing heard yet of image and odometry", "WARNING")]
    assert not monitor.wrong


def test_what_is_silent_from_the_begin_is_told_with_what_to_do() -> None:
    settings = read_config(None, ["live.topics.image=/cam", "live.dds=7"])
    options, topics = LiveOptions([CORRIDOR / "map.yaml"], settings), {"image": "/cam", "odometry": "/odom"}
    text = advice(options, topics, ["image", "odometry"], joined=True)
    assert "getting ready" in advice(replace(options, stand_in=True), topics, ["image"], joined=True)
    assert text.startswith(
        "nothing heard yet of image (/cam) and odometry (/odom), at domain 7 of DDS on the interface"
    )
    assert "--set live.topics.image=NAME" in text and "--set live.interface=eth0" in text
    options = replace(options, config=read_config(None, ["live.connect=tcp/robot:7447"]), image="0")
    text = advice(options, topics, ["image"], joined=False)
    assert "image (0), at tcp/robot:7447, domain 0; no zenoh router answers" in text and "rmw_zenohd" in text


def test_the_stand_in_of_a_demo_is_where_the_run_is(localiser: Localiser) -> None:
    with patch("localiser.commands.live._run"), patch("localiser.commands.live._stand_in") as stand_in:
        localiser("live", "demo", CORRIDOR, "--set", "live.namespace=robot1", "--set", "live.domain=7")
    there = read_config(None, stand_in.call_args.args[1]).live
    assert (there.namespace, there.domain) == ("robot1", 7) and there.listen


def test_a_source_that_was_heard_and_falls_silent_is_a_warning(monitor: Monitor, said: list[tuple[str, str]]) -> None:
    with at(100.0):
        monitor.heard("image")
    with at(102.0):
        monitor.watch(("image",))
    with at(103.0):
        monitor.heard("image")
    assert [level for _, level in said] == ["WARNING", "INFO"]
    assert said[1][0] == "image: back after 3.0 s"
    assert monitor.wrong == {"image silent": 1}


def test_what_is_waited_for_is_wrong_only_when_it_lasts(monitor: Monitor, said: list[tuple[str, str]]) -> None:
    for seconds in (100.0, 105.0, 111.0):
        with at(seconds):
            monitor.wait("no camera", "images wait for the camera")
    assert [level for _, level in said] == ["INFO", "WARNING"]


def test_the_line_says_where_the_robot_is_and_the_table_what_the_run_came_to() -> None:
    feed = Feed()
    assert status_line(feed.run.outputs.monitor) == "waiting for the first image"
    feed([*camera(), *drive(8)])
    monitor, last = feed.run.outputs.monitor, feed.published[-1].located
    line = status_line(monitor)
    x, z, _ = last.estimate.pose
    assert line.startswith(f"{x:.2f}, {z:.2f} ± ")
    assert f"sure {last.p_correct:.2f}" in line and line.endswith(f"/{len(last.edges)}") and "warning" not in line
    assert len(line) <= 80
    assert any(text.startswith("sure of the pose: x = ") for text in feed.said)

    monitor.warn("bad image", "left out an image")
    assert f"sure {last.p_correct:.2f}  1 warning  " in status_line(monitor)
    console = Console(width=80, color_system=None)
    with console.capture() as capture:
        console.print(end_table(feed.run))
    rows = [" ".join(row.split()) for row in capture.get().splitlines()]
    assert f"images located {len(feed.published)}" in rows
    assert {"images sure 100 %", "warning: bad image 1"} <= set(rows)


@pytest.mark.parametrize(("grey", "kind"), [(10, "dark images"), (255, "washed-out images")])
def test_an_image_in_bad_light_is_told(grey: int, kind: str) -> None:
    size = LOG.camera.height, LOG.camera.width
    plain = cv2.imencode(".png", np.full(size, grey, dtype=np.uint8))[1].tobytes()
    feed = Feed()([*camera(), *drive(1)])
    assert not {"dark images", "washed-out images"} & set(feed.run.outputs.monitor.wrong)
    feed = Feed()([*camera(), *(image(one.at_ns, 0, plain) if one.role == "image" else one for one in drive(1))])
    assert feed.run.outputs.monitor.wrong[kind] == 1
    assert any(("is dark" if grey < 64 else "is washed out") in text for text in feed.said)


def test_wheels_that_contradict_the_edges_are_told_with_both_motions() -> None:
    feed = Feed()([*camera(), *drive(2)])
    monitor, said = feed.run.outputs.monitor, len(feed.said)
    assert "wheels" not in monitor.wrong
    located = monitor.newest.located
    ahead = replace(
        located,
        odometry=compose(located.odometry, [0.0, -0.5, 0.0]),
        increment=Increment.from_mean(np.array([0.0, -0.1, np.radians(2.0)])),
        wheels_are_wrong=True,
    )
    monitor.located(replace(monitor.newest, located=ahead), 1.0, 1.0, None)
    assert monitor.wrong["wheels"] == 1
    assert feed.said[said:] == ["the wheels contradict the edges: 0.50 m and 0.0° instead of 0.10 m and 2.0°"]


def test_it_is_told_that_the_pose_may_jump_and_that_it_jumped() -> None:
    feed = Feed()([*camera(), *drive(2)])
    monitor, said = feed.run.outputs.monitor, len(feed.said)
    sure = monitor.newest
    lost = replace(sure, located=replace(sure.located, reason="several places fit"), wide_cov=np.eye(3))
    there = replace(sure, located=replace(sure.located, took_over=True))
    for frame in (lost, lost, there):
        monitor.located(frame, 1.0, 1.0, None)
    assert feed.said[said:] == [
        "the robot may be at another place (several places fit): the pose may jump there",
        "another place fits better: the pose jumped there",
    ]


def test_the_way_back_is_the_way_there_mirrored() -> None:
    passage = Passage.of(LOG)
    there, back = list(passage.messages(there=True)), list(passage.messages(there=False))
    for way in (there, back):
        for topic in (IMAGE, WHEELS):
            assert (np.diff([t_ns for t_ns, name, _ in way if name == topic]) > 0).all()
    turned = {(passage.length_ns - t_ns, name, k) for t_ns, name, k in back}
    ends = {message for message in there if message[0] in (0, passage.length_ns)}
    assert turned == set(there) - ends


def test_odometry_that_is_sent_more_often_goes_the_same_way() -> None:
    dense = Passage.of(LOG).wheels
    moved = between(dense.poses[:-1], dense.poses[1:])
    assert np.hypot(moved[:, 0], moved[:, 1]).max() < 0.01
    np.testing.assert_allclose(dense.sampled(LOG.odometry.t_ns[:50]).poses, LOG.odometry.poses[:50], atol=1e-9)


def test_a_log_is_sent_as_a_robot_sends_it(tmp_path: Path) -> None:
    """Two ways of a short log: stamps go on, images are the files, the mount is latched, names are in the namespace."""
    log = open_log(write_small_log(tmp_path / "log"))
    wire = KeepingTransport()
    StandIn(wire, Passage.of(log), "/robot1").run(Event(), ways=2)
    images = wire.messages(f"/robot1{IMAGE.name}")
    assert len(images) == len(wire.messages(f"/robot1{INFO.name}")) >= 4
    assert images[0].data.tobytes() == log.frames[0].encoded()
    assert [topic.latched for topic, _ in wire.sent[f"/robot1{FIXED.name}"]] == [True]
    stamps = [message.header.stamp for message in wire.messages(f"/robot1{WHEELS.name}")]
    assert (np.diff([stamp.sec * 10**9 + stamp.nanosec for stamp in stamps]) > 0).all()


def test_what_cannot_be_driven_is_refused(tmp_path: Path, localiser: Localiser) -> None:
    with pytest.raises(InputError, match="log with images"):
        Passage.of(open_log(write_edge_log(tmp_path / "log")))
    result = localiser("simulate", CORRIDOR)
    assert result.exit_code == 2 and "--serve" in result.err


def test_a_mount_that_moves_is_sent_with_each_image(tmp_path: Path) -> None:
    log = open_log(write_small_log(tmp_path / "log"))
    usual = log.camera.mount
    frames = [
        replace(frame, mount=replace(usual, tilt_rad=usual.tilt_rad + 0.01 * k)) for k, frame in enumerate(log.frames)
    ]
    wire = KeepingTransport()
    StandIn(wire, Passage.of(replace(log, frames=frames))).run(Event(), ways=1)
    images, moving = wire.messages(IMAGE.name), wire.messages(MOVING.name)
    assert not wire.messages(FIXED.name)
    assert len(moving) == len(images) >= 2
    tilts = []
    for message, picture in zip(moving, images, strict=True):
        (stamped,) = message.transforms
        assert stamped.header.stamp == picture.header.stamp
        tree = FrameTree()
        tree.add_all(message.transforms)
        tilts.append(mount_of(tree, stamped.header.frame_id, stamped.child_frame_id).tilt_rad)
    np.testing.assert_allclose(tilts, [frame.mount.tilt_rad for frame in frames[: len(tilts)]], atol=1e-9)
