"""Where live messages come from: the inbox, also in a flood, and cameras."""

import json
import time
from dataclasses import replace
from pathlib import Path

import attack_bombs as bombs
import cv2
import numpy as np
import pytest
from bounded import bounded
from hypothesis import given
from hypothesis import strategies as st
from live_feed import LOG, Feed, arrival, camera, drive, image, odometry

from localiser.errors import InputError
from localiser.image_files import decode
from localiser.live.inbox import MOST_IMAGES, MOST_OTHERS, TOPICS, Arrival, CameraSource, Inbox, message_of
from localiser.live.prepare import open_camera
from localiser.storage.bags import stamp_of

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
