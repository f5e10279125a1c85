"""A flood of messages, without processes and without a clock: what of it is kept, and which images are lost by it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from live_feed import LOG, Feed, arrival, camera, drive, image, odometry

from localiser.live.inbox import MOST_BYTES, MOST_IMAGES, MOST_OTHERS, Arrival, Inbox

FLOOD = 40_000
BEFORE, AFTER = 4, 6


def junk(t_ns: int) -> Arrival:
    return arrival("odometry", t_ns, bytes(720))


@pytest.mark.parametrize("kind", ["junk", "odometry", "images"])
def test_no_image_after_a_flood_is_lost(kind: str) -> None:
    """All of it comes at once; the loop takes what the inbox kept, and locates every image that comes from then on."""
    feed = Feed()([*camera(), *drive(BEFORE)])
    flooded_ns = LOG.frames[BEFORE].t_ns
    message = {"junk": junk(flooded_ns), "odometry": odometry(flooded_ns), "images": image(flooded_ns, BEFORE)}[kind]
    inbox = feed.run.inbox
    for _ in range(FLOOD):
        inbox.put(replace(message))
    most = MOST_IMAGES if kind == "images" else MOST_OTHERS
    assert inbox.dropped[message.role] == FLOOD - most
    feed.now_ns = flooded_ns
    kept = inbox.take(0.0)
    assert len(kept) == most
    feed.run.turn(kept)
    feed(drive(AFTER, first=BEFORE + 1))
    expected = [frame.t_ns for frame in LOG.frames[BEFORE + 1 : BEFORE + 1 + AFTER]]
    assert feed.times[-AFTER:] == expected
    assert feed.worst_error_m() < 0.15


def test_a_flood_of_large_messages_is_bounded_in_bytes() -> None:
    inbox, large = Inbox(), bytes(2**20)
    for number in range(FLOOD):
        inbox.put(Arrival("groundtruth", "groundtruth", large, at_ns=number, wall_ns=number))
    kept = inbox.take(0.0)
    assert sum(len(one.content) for one in kept) == MOST_BYTES
    assert kept[-1].at_ns == FLOOD - 1
