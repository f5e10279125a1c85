"""Messages of a live run: those that are none, floods, what costs much, and cameras."""

import json
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import attack_bombs as bombs
import cv2
import numpy as np
import pytest
from bounded import bounded
from fuzzing import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from live_feed import BEGIN_NS, LOG, MAKE, Feed, arrival, camera, drive, image, odometry

from localiser.errors import InputError
from localiser.image_files import decode
from localiser.live.clock import RobotClock
from localiser.live.inbox import MOST_IMAGES, MOST_OTHERS, TOPICS, Arrival, CameraSource, Inbox, message_of
from localiser.live.prepare import open_camera
from localiser.storage.bags import stamp_of
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


PATIENCE_S = 30.0


@given(roles=st.lists(st.sampled_from(["image", "odometry", "transforms"]), max_size=60))
def test_a_full_inbox_keeps_the_newest_of_each_role_in_order(roles: list[str]) -> None:
    inbox = Inbox(most_images=3, most_others=5)
    arrivals = [Arrival(role, role, b"", at_ns=k, wall_ns=k) for k, role in enumerate(roles)]
    for one in arrivals:
        inbox.put(one)
    expected = set()
    for role, most in (("image", 3), ("odometry", 5), ("transforms", 5)):
        of_role = [arrival.at_ns for arrival in arrivals if arrival.role == role]
        expected |= set(of_role[-most:])
        assert inbox.dropped[role] == max(len(of_role) - most, 0)
    assert [arrival.at_ns for arrival in inbox.take(0.0)] == sorted(expected)
    assert inbox.take(0.0) == []


def test_a_full_inbox_holds_no_more_bytes_than_it_may() -> None:
    """What needs the most memory is dropped first: large images, not the odometry that came before them."""
    inbox = Inbox(most_bytes=1000)
    inbox.put(Arrival("odometry", "odometry", bytes(100), at_ns=0))
    for k in range(1, 6):
        inbox.put(Arrival("image", "image", bytes(400), at_ns=k))
    assert [arrival.at_ns for arrival in inbox.take(0.0)] == [0, 4, 5] and inbox.dropped == {"image": 3}
    inbox.put(Arrival("image", "image", bytes(2000), at_ns=6))
    assert inbox.take(0.0) == []


# -- cameras ----------------------------------------------------------------------------------------------------------


def test_a_video_file_is_a_camera(tmp_path: Path) -> None:
    """Every frame comes with the time that it has in the file."""
    path = tmp_path / "drive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (64, 48))
    for level in range(5):
        writer.write(np.full((48, 64, 3), 40 * level, dtype=np.uint8))
    writer.release()
    frames = taken(path, 5)
    images = [cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_GRAYSCALE) for _, file in frames]
    assert [round(float(image.mean()) / 40) for image in images] == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(np.diff([t_ns for t_ns, _ in frames]), 5e7, atol=1e6)


def taken(path: Path, count: int) -> list[tuple[int, bytes]]:
    """Return time and file of the first frames of a video, which arrive as a robot sends them."""
    inbox = Inbox()
    source = open_camera(str(path), TOPICS["image"], inbox)
    frames: list[tuple[int, bytes]] = []
    end = time.monotonic() + PATIENCE_S
    while len(frames) < count and time.monotonic() < end:
        messages = [message_of(one) for one in inbox.take(0.1)]
        frames += [(stamp_of(message), message.data.tobytes()) for message in messages]
    source.close()
    assert abs(time.time() - frames[-1][0] / 1e9) < 60
    return frames


def test_pictures_of_a_stream_are_not_decoded_before_they_are_checked(tmp_path: Path) -> None:
    """Those that are JPEG files reach the check of every image that comes in, as they are."""
    bomb, fine = bombs.jpeg_of_scans((64, 48), 300), bombs.jpeg_of_scans((64, 48), 10)
    (tmp_path / "drive.avi").write_bytes(bombs.movie([fine, bomb], (64, 48), b"MJPG"))
    files = [file for _, file in taken(tmp_path / "drive.avi", 2)]
    assert [file.startswith(one) for file, one in zip(files, (fine, bomb), strict=True)] == [True, True]
    with pytest.raises(ValueError, match="at most 100 scans"):
        decode(files[1], cv2.IMREAD_COLOR)


@pytest.mark.parametrize(
    ("size", "codec", "told"), [((64, 48), b"MPNG", "found PNG"), ((8192, 8192), b"MJPG", "found 8192×8192")]
)
def test_streams_that_cannot_be_checked_are_refused(tmp_path, size, codec, told):
    frame = bombs.black((64, 48)) if codec == b"MPNG" else bombs.jpeg_of_scans(size, 1)
    (tmp_path / "drive.avi").write_bytes(bombs.movie([frame], size, codec))
    with pytest.raises(InputError, match=told):
        CameraSource(str(tmp_path / "drive.avi"), lambda t_ns, file: None)


def test_a_camera_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="camera that can be opened"):
        CameraSource(str(tmp_path / "none.mp4"), lambda t_ns, file: None)


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


MANY_FRAMES = """
import json
import sys
import attack_bombs as bombs
from live_feed import BEGIN_NS, MAKE, Feed, arrival, camera, drive
feeds = []
for at_once in (15_000, 500):
    known = (sys.argv[1] == "moving_transforms") == (at_once == 500)
    content = [bombs.many_frames(MAKE, at_once, first, BEGIN_NS) for first in range(0, 15_000, at_once)]
    hostile = [arrival(sys.argv[1], 0, one) for one in content]
    feed = Feed()([*camera(), *drive(2)])
    feeds.append((feed, [*hostile, *drive(10, first=2)]) if known else (Feed(), [*hostile, *camera(), *drive(12)]))
begin()
print(json.dumps([[len(feed(messages).published), feed.said[-30:]] for feed, messages in feeds]))
"""


@pytest.mark.parametrize(("role", "topic"), [("transforms", "/tf_static"), ("moving_transforms", "/tf")])
def test_messages_of_a_neighbour_that_ask_for_much_cost_little(role: str, topic: str) -> None:
    """At once, or in several messages; before the camera is known, or afterwards. They leave nothing behind."""
    told = ("at most 262144 bytes", "fewer than 1000 transforms")
    for (located, said), expected in zip(json.loads(bounded(MANY_FRAMES, role)), told, strict=True):
        assert located == 12 and f"{topic}: left out a message: expected {expected}" in " ".join(said)
