"""A live run by the time of a simulator or of a bag that is played; and with a camera that moves on its robot."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_feed import BEGIN_NS, LOG, MAKE, Feed, arrival, camera, drive, image, odometry

from localiser.camera import Mount
from localiser.live.clock import SLACK_NS, SimulatedTime
from localiser.live.inbox import Arrival
from localiser.live.timeline import PATIENCE_NS
from localiser.replay import replay_log
from localiser.storage import open_log
from localiser.storage.bags import RosType

N = 6
STEP_NS = 25_000_000


def clock(t_ns: int) -> Arrival:
    seconds, nanoseconds = divmod(BEGIN_NS + t_ns, 10**9)
    return arrival("clock", t_ns, MAKE.encode(MAKE.make(RosType.CLOCK, clock={"sec": seconds, "nanosec": nanoseconds})))


def played(messages: list[Arrival], rate: float, begin_ns: int = 0) -> Iterable[Arrival]:
    """Return messages with those of the clock among them, as a player sends them at `rate` times their own speed."""
    ticks = [clock(t_ns) for t_ns in range(0, messages[-1].at_ns, STEP_NS)]
    for message in sorted([*ticks, *messages], key=lambda message: message.at_ns):
        yield replace(message, at_ns=begin_ns + round(message.at_ns / rate))


def simulated(**settings: object) -> Feed:
    feed = Feed(**settings)
    feed.run.clocks.simulated = SimulatedTime()
    return feed


@pytest.mark.parametrize("rate", [0.05, 1.0, 20.0])
def test_a_bag_is_localised_at_any_rate(rate: float) -> None:
    feed = simulated()([*camera(), *played(drive(N), rate)])
    assert feed.times == [frame.t_ns for frame in LOG.frames[:N]]
    assert feed.worst_error_m() < 0.3 and not feed.run.outputs.monitor.wrong
    assert all(abs(published.latency_ms) < 1000 for published in feed.published)


def test_messages_before_the_first_of_the_clock_are_left_out() -> None:
    feed = simulated()([*camera(), *drive(2)])
    assert not feed.published and any("/clock" in text for text in feed.said)
    feed(played(drive(N), 1.0))
    assert feed.published


def test_a_bag_that_begins_again_begins_a_new_run_and_the_recording_replays(localiser, tmp_path):
    """The robot is where it started, the stamps that go out are the robot's, nothing is thought to be wrong."""
    feed = simulated(record=tmp_path / "drive.db3")
    feed(camera())
    for turn in range(2):
        feed(played(drive(N), 1.0, turn * 10**10))
    stamps = [published.stamp_ns - BEGIN_NS for published in feed.published]
    assert stamps == [frame.t_ns for frame in LOG.frames[:N]] * 2
    assert (np.diff(feed.times) > 0).all()
    assert np.hypot(*(feed.poses - LOG.groundtruth.sampled(stamps).poses)[:, :2].T).max() < 0.3
    assert sum("begins anew" in text for text in feed.said) == 1
    feed.assert_replays(localiser)


@pytest.mark.parametrize(
    ("start", "behind_ns"),
    [
        (LOG.start, 70_000_000),
        (None, -70_000_000),
        pytest.param(LOG.start, -70_000_000, marks=pytest.mark.slow),
        pytest.param(None, 70_000_000, marks=pytest.mark.slow),
    ],
)
def test_messages_and_the_clock_of_a_bag_in_a_loop_may_overtake_each_other(localiser, tmp_path, behind_ns, start):
    """The clock at 10 Hz, the wheels at 100 Hz: each loop begins anew once, and loses no image that the first had.

    behind_ns: how much later than others messages of the clock come.
    """
    wheels = [odometry(t_ns) for t_ns in range(0, LOG.frames[N].t_ns, 10_000_000)]
    pictures = [image(LOG.frames[k].t_ns, k) for k in range(N)]
    ticks = [clock(t_ns) for t_ns in range(0, LOG.frames[N].t_ns, 100_000_000)]
    late = [replace(tick, at_ns=tick.at_ns + behind_ns) for tick in ticks]
    loop_ns = LOG.frames[N].t_ns
    loops = [
        replace(message, at_ns=message.at_ns + turn * loop_ns)
        for turn in range(4)
        for message in [*wheels, *pictures, *late]
    ]
    feed = simulated(start=start, record=tmp_path / "drive.db3")
    feed([*camera(), *sorted(loops, key=lambda message: message.at_ns)])
    stamps = [published.stamp_ns - BEGIN_NS for published in feed.published]
    first = stamps[: next(k for k in range(1, len(stamps)) if stamps[k] < stamps[k - 1])]
    for stamp_ns in first:
        assert stamps.count(stamp_ns) == 4, (stamp_ns, stamps)
    assert not feed.run.outputs.monitor.wrong, feed.run.outputs.monitor.wrong
    assert sum("begins anew" in text for text in feed.said) == 3 and not feed.run.clocks.robot.jumps
    feed.assert_replays(localiser)


def test_time_goes_on_steadily_whatever_the_clock_does() -> None:
    time = SimulatedTime()
    assert not time.is_known
    nows = []
    for clock_ns in (5 * 10**9, 6 * 10**9, 6 * 10**9 - SLACK_NS // 2, 0, 10**9, 50 * 10**9, 2 * 10**9):
        time.take(clock_ns)
        nows.append(time.now_ns)
    assert (np.diff(nows) >= 0).all() and time.clock_ns == 2 * 10**9
    assert time.take(0) == 2 * 10**9 + 1


IMAGES = 5
END_NS = LOG.frames[IMAGES - 1].t_ns + 60_000_000
BETWEEN_NS = 30_000_000


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
    return [*info, *sorted([*moving, *drive(IMAGES)], key=lambda message: message.at_ns)]


NODDING = [transforms(t_ns) for t_ns in range(0, END_NS + BETWEEN_NS, BETWEEN_NS)]


@pytest.fixture(scope="module")
def nodding() -> Feed:
    return Feed()(sent(NODDING))


def test_every_image_has_the_mount_of_its_time(nodding: Feed) -> None:
    assert nodding.times == [frame.t_ns for frame in LOG.frames[:IMAGES]]
    for published in nodding.published:
        mount = published.located.edges.mount
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
    assert len(feed.poses) == IMAGES
    np.testing.assert_array_equal(feed.poses, nodding.poses)
    assert all(
        published.located.t_ns + late_ns <= now_ns for published, now_ns in zip(feed.published, come_at, strict=True)
    )


def test_an_image_without_transforms_is_left_out_after_some_time(nodding: Feed) -> None:
    silent_ns = LOG.frames[2].t_ns - BETWEEN_NS
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
    own = [
        arrival("moving_transforms", message_ns, MAKE.encode(message)) for message_ns in range(0, END_NS, BETWEEN_NS)
    ]
    feed = Feed()(sent([*NODDING, *own]))
    np.testing.assert_array_equal(feed.poses, nodding.poses)


def test_fixed_transforms_come_before_those_that_change() -> None:
    feed = Feed()([*camera(), *sorted([*NODDING, *drive(IMAGES)], key=lambda message: message.at_ns)])
    assert all(published.located.edges.mount is None for published in feed.published)
    assert len(feed.times) == IMAGES
