"""Who sends: two publishers on one topic are told, a robot that was started again is not."""

from __future__ import annotations

from dataclasses import replace

from live_feed import LOG, Feed, camera, drive

N = 6


def test_two_publishers_on_one_topic_are_told() -> None:
    """The robot's images, and those of another camera in turn."""
    messages = drive(N)
    images = [message for message in messages if message.role == "image"]
    turns = [replace(message, source=bytes([k % 2 + 1]) * 16) for k, message in enumerate(images)]
    others = [message for message in messages if message.role != "image"]
    feed = Feed()([*camera(), *sorted([*others, *turns], key=lambda message: message.at_ns)])
    assert feed.run.outputs.monitor.wrong == {"two publishers of image": N - 2}
    assert sum("expected one publisher" in text for text in feed.said) == 1
    assert len(feed.times) == N


def test_a_robot_that_was_started_again_is_not_told() -> None:
    half = LOG.frames[N // 2].t_ns
    messages = [replace(message, source=bytes([1 + (message.at_ns > half)]) * 16) for message in drive(N)]
    feed = Feed()([*camera(), *messages])
    assert not feed.run.outputs.monitor.wrong and len(feed.times) == N
