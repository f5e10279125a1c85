"""A live run by the time of a simulator or of a bag that is played, and not by this machine's."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_feed import BEGIN_NS, LOG, MAKE, Feed, arrival, camera, drive, image, odometry
from short_log import Localiser

from localiser.filter import Start
from localiser.live.clock import SLACK_NS, SimulatedTime
from localiser.live.inbox import Arrival
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


def test_a_bag_that_begins_again_begins_a_new_run_and_the_recording_replays(
    localiser: Localiser, tmp_path: Path
) -> None:
    """The robot is where it started, the stamps that go out are the robot's, nothing is thought to be wrong."""
    feed = simulated(record=tmp_path / "drive.db3")
    feed(camera())
    for turn in range(2):
        feed(played(drive(N), 1.0, turn * 10**10))
    stamps = [published.stamp_ns - BEGIN_NS for published in feed.published]
    assert stamps == [frame.t_ns for frame in LOG.frames[:N]] * 2
    assert (np.diff(feed.times) > 0).all()
    truth = LOG.groundtruth.sampled(stamps).poses
    assert np.hypot(*(feed.poses - truth)[:, :2].T).max() < 0.3
    assert sum("begins anew" in text for text in feed.said) == 1
    feed.assert_replays(localiser)


@pytest.mark.parametrize("behind_ns", [70_000_000, -70_000_000])
@pytest.mark.parametrize("start", [LOG.start, None])
def test_messages_and_the_clock_of_a_bag_in_a_loop_may_overtake_each_other(
    localiser: Localiser, tmp_path: Path, behind_ns: int, start: Start | None
) -> None:
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
    feed = simulated(start=start, record=tmp_path / "drive.db3")(
        [*camera(), *sorted(loops, key=lambda message: message.at_ns)]
    )
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
