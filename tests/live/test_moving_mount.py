"""A live run of a camera that moves on its robot: /tf says how it was mounted when each image was taken."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_feed import BEGIN_NS, LOG, MAKE, Feed, arrival, camera, drive

from localiser.camera import Mount
from localiser.live.inbox import Arrival
from localiser.live.timeline import PATIENCE_NS
from localiser.replay import replay_log
from localiser.storage import open_log

N = 5
END_NS = LOG.frames[N - 1].t_ns + 60_000_000
STEP_NS = 30_000_000


def mount_at(t_ns: int) -> Mount:
    """The true mount, its tilt off by up to a degree, as a head that nods."""
    usual = LOG.camera.mount
    return replace(usual, tilt_rad=usual.tilt_rad + np.deg2rad(1.0) * t_ns / END_NS)


def transforms(t_ns: int, come_ns: int | None = None) -> Arrival:
    message = MAKE.mount(BEGIN_NS + t_ns, LOG.camera.at(mount_at(t_ns)))
    return arrival("moving_transforms", t_ns if come_ns is None else come_ns, MAKE.encode(message))


def sent(moving: list[Arrival]) -> list[Arrival]:
    """Return what a robot sends during the first images, without fixed transforms."""
    info = [each for each in camera() if each.role == "camera_info"]
    return [*info, *sorted([*moving, *drive(N)], key=lambda message: message.at_ns)]


NODDING = [transforms(t_ns) for t_ns in range(0, END_NS + STEP_NS, STEP_NS)]


@pytest.fixture(scope="module")
def nodding() -> Feed:
    return Feed()(sent(NODDING))


def test_every_image_has_the_mount_of_its_time(nodding: Feed) -> None:
    assert nodding.times == [frame.t_ns for frame in LOG.frames[:N]]
    for published in nodding.published:
        mount = published.located.edges.mount
        assert mount is not None
        expected = mount_at(published.located.t_ns - BEGIN_NS)
        assert mount.tilt_rad == pytest.approx(expected.tilt_rad, abs=1e-9)
        assert mount.height_m == pytest.approx(expected.height_m, abs=1e-9)


def test_an_image_waits_until_the_transforms_have_passed_it(nodding: Feed) -> None:
    late_ns, come_at = 200_000_000, []
    late = [transforms(message.at_ns, message.at_ns + late_ns) for message in NODDING[1:]]
    feed = Feed()

    def note() -> None:
        come_at.extend([BEGIN_NS + feed.now_ns] * (len(feed.published) - len(come_at)))

    feed(sent([NODDING[0], *late]), note)
    assert len(feed.poses) == N
    np.testing.assert_array_equal(feed.poses, nodding.poses)
    assert all(
        published.located.t_ns + late_ns <= now_ns for published, now_ns in zip(feed.published, come_at, strict=True)
    )


def test_an_image_without_transforms_is_left_out_after_some_time(nodding: Feed) -> None:
    silent_ns = LOG.frames[2].t_ns - STEP_NS
    feed = Feed()(sent([message for message in NODDING if message.at_ns < silent_ns]))
    assert len(feed.times) == 2
    feed.now_ns += PATIENCE_NS
    feed.run.turn([])
    assert feed.tracker.timeline.skipped["no transforms"] >= 1
    np.testing.assert_array_equal(feed.poses, nodding.poses[:2])


def test_a_recording_is_replayed_to_the_same_poses(tmp_path: Path) -> None:
    feed = Feed(record=tmp_path / "run.db3")(sent(NODDING))
    feed.close()
    replayed = replay_log(open_log(tmp_path / "run.db3"), feed.config)
    np.testing.assert_array_equal(replayed.track.poses, feed.poses)


def test_our_own_transforms_on_the_same_topic_are_left_aside(nodding: Feed) -> None:
    message = MAKE.mount(BEGIN_NS, LOG.camera)
    message.transforms[0].header.frame_id = "map"
    own = [arrival("moving_transforms", message_ns, MAKE.encode(message)) for message_ns in range(0, END_NS, STEP_NS)]
    feed = Feed()(sent([*NODDING, *own]))
    np.testing.assert_array_equal(feed.poses, nodding.poses)


def test_fixed_transforms_come_before_those_that_change() -> None:
    feed = Feed()([*camera(), *sorted([*NODDING, *drive(N)], key=lambda message: message.at_ns)])
    assert all(published.located.edges.mount is None for published in feed.published)
    assert len(feed.times) == N
