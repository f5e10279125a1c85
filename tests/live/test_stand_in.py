"""The stand-in for a robot: a log sent to and fro."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from live_feed import LOG
from live_transport import KeepingTransport
from short_log import CORRIDOR, Localiser
from small_log import write_edge_log, write_small_log

from localiser.errors import InputError
from localiser.geometry import between
from localiser.live.stand_in import FIXED, IMAGE, INFO, MOVING, WHEELS, Passage, StandIn
from localiser.storage import open_log
from localiser.storage.bags.frames import FrameTree, mount_of


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
    for message, image in zip(moving, images, strict=True):
        (stamped,) = message.transforms
        assert stamped.header.stamp == image.header.stamp
        tree = FrameTree()
        tree.add_all(message.transforms)
        tilts.append(mount_of(tree, stamped.header.frame_id, stamped.child_frame_id).tilt_rad)
    np.testing.assert_allclose(tilts, [frame.mount.tilt_rad for frame in frames[: len(tilts)]], atol=1e-9)
