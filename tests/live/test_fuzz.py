"""Messages that are none: no crash, no hang, and the run goes on."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
from fuzzing import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from live_feed import BEGIN_NS, MAKE, Feed, arrival, camera, drive, image, odometry

from localiser.live.clock import RobotClock
from localiser.live.inbox import TOPICS, Arrival, message_of
from localiser.storage.bags.write import Decisions

DAMAGED = 10_000


def samples() -> list[Arrival]:
    pose = MAKE.encode(MAKE.pose_in_map(BEGIN_NS, np.zeros(3), np.eye(3)))
    truth = MAKE.encode(MAKE.odometry(BEGIN_NS, "map", np.zeros(3)))
    others = [arrival("initialpose", 0, pose), arrival("groundtruth", 0, truth)]
    return [*camera(), image(0, 0), odometry(0), *others]


def damaged(message: Arrival, rng: np.random.Generator) -> Arrival:
    """Return the message cut off, with bytes changed, or with bytes of chance in its place."""
    content = bytearray(message.content)
    kind = rng.integers(4)
    if kind == 0:
        content = content[: rng.integers(len(content))]
    elif kind == 1:
        content = bytearray(rng.bytes(int(rng.integers(400))))
    else:
        most = len(content) if kind == 2 else min(len(content), 160)  # where sizes, stamps and counts are
        for place in rng.integers(most, size=rng.integers(1, 9)):
            content[place] = rng.integers(256)
    return replace(message, content=bytes(content))


def test_ten_thousand_damaged_messages_and_the_run_goes_on() -> None:
    rng = np.random.default_rng(1)
    feed = Feed()([*camera(), *drive(2)])
    messages = samples()
    for k in range(DAMAGED):
        message = messages[k % len(messages)]
        feed.now_ns += 1000
        feed.run.turn([damaged(replace(message, at_ns=feed.now_ns), rng)])
    feed.published.clear()
    feed(camera())
    feed(drive(6, first=3))
    assert len(feed.published) >= 4
    assert sum(count for what, count in feed.run.outputs.monitor.counts.items() if what.startswith("bad")) > DAMAGED / 2
    said = [text for text in feed.said if not text.startswith("started at")]
    assert len(said) < 100, "not a word for every message"
    assert np.isfinite(feed.poses).all()


@settings(max_examples=examples(300))
@given(role=st.sampled_from(sorted(TOPICS)), content=st.binary(max_size=300))
def test_any_bytes_are_a_message_or_an_error(role: str, content: bytes) -> None:
    try:
        message_of(Arrival(role, TOPICS[role], content))
    except ValueError as error:
        assert "expected" in str(error)


@settings(max_examples=examples(300))
@given(
    text=st.text(max_size=60)
    | st.sampled_from(['{"image": 1, "used": 3}', '{"start": 1}', "[" * 5000, '{"clock": 1e9}'])
)
def test_any_text_is_a_decision_or_an_error(text: str) -> None:
    with suppress(ValueError):
        Decisions().take(text)


@settings(max_examples=examples(200))
@given(steps=st.lists(st.tuples(st.integers(-(10**10), 10**10), st.integers(0, 10**9)), min_size=1, max_size=60))
def test_times_of_any_stamps_go_on_with_the_clock(steps: list[tuple[int, int]]) -> None:
    """No time is far ahead of what has passed, whatever the stamps say, once a clock is known."""
    clock = RobotClock()
    begin_ns = clock.time_of(10**12, 0)
    assert begin_ns is not None
    at_ns = 0
    for stamp, wait_ns in steps:
        at_ns += wait_ns
        t_ns = clock.time_of(10**12 + stamp, at_ns)
        if t_ns is not None:
            assert t_ns <= begin_ns + at_ns + 260_000_000 * (1 + len(steps))


def test_a_steady_clock_is_believed_and_an_outlier_is_not() -> None:
    clock = RobotClock()
    for k in range(50):
        assert clock.time_of(k * 20_000_000, k * 20_000_000 + (k % 5) * 1_000_000) == k * 20_000_000
    assert clock.time_of(10**12, 10**9) is None
    assert clock.time_of(50 * 20_000_000, 10**9) == 50 * 20_000_000 and clock.offset_ns == 0


def test_messages_held_up_on_their_way_are_no_jump() -> None:
    """A network that stands still for ten seconds and then delivers everything at once."""
    clock = RobotClock()
    times = [k * 20_000_000 for k in range(600)]
    arrived = [t_ns if t_ns < 10**9 else max(t_ns, 11 * 10**9) for t_ns in times]
    assert [clock.time_of(t_ns, at_ns) for t_ns, at_ns in zip(times, arrived, strict=True)] == times
