"""Recordings: committed as they go on, ended by a full disk, and whatever they hold opens and replays."""

import sqlite3
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from live_feed import BEGIN_NS, LOG, MAKE, Feed, arrival, camera, drive, image
from recorded_texts import text, texts
from short_log import Localiser

from localiser.camera import Camera
from localiser.errors import InputError
from localiser.live.clock import AGREEING
from localiser.live.inbox import Arrival
from localiser.live.outputs import Recording
from localiser.storage import open_log, read_track
from localiser.storage.bags import RosType
from localiser.storage.images import encode_image

PATIENCE_S = 60.0


def test_a_recording_is_committed_while_it_goes_on(tmp_path: Path) -> None:
    failures: list[str] = []
    recording = Recording(tmp_path / "a.db3", failures.append)
    recording.write("/a", RosType.TEXT, 1, text("now"))
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end and not _readable(tmp_path / "a.db3"):
        time.sleep(0.05)
    assert texts(tmp_path / "a.db3") == ["now"]
    recording.write("/a", RosType.TEXT, 2, text("later"))
    recording.close()
    assert texts(tmp_path / "a.db3") == ["now", "later"] and not failures


def _readable(path: Path) -> bool:
    try:
        return bool(texts(path))
    except InputError:
        return False


def test_a_full_disk_ends_the_recording_with_a_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def connect_to_small_disk(*arguments: Any, **options: Any) -> sqlite3.Connection:
        database = connect(*arguments, **options)
        database.execute("PRAGMA max_page_count = 60")  # SQLite says that the disk is full
        return database

    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", connect_to_small_disk)
    failures: list[str] = []
    recording = Recording(tmp_path / "a.db3", failures.append)
    for k in range(200):
        recording.write("/a", RosType.TEXT, k, text("x" * 4000))
    end = time.monotonic() + PATIENCE_S
    while not failures and time.monotonic() < end:
        time.sleep(0.05)
    assert len(failures) == 1 and "full" in failures[0] and "the run goes on" in failures[0]
    recording.write("/a", RosType.TEXT, 1000, text("too late"))  # no error
    recording.close()


N = 3
YEARS_NS = 10 * 365 * 86400 * 10**9


@pytest.mark.parametrize(
    "other",
    [
        replace(LOG.camera, width=LOG.camera.width - 1),
        pytest.param(replace(LOG.camera, height=LOG.camera.height + 1), marks=pytest.mark.slow),
        replace(LOG.camera, fx=LOG.camera.fx + 1),
        pytest.param(
            replace(LOG.camera, distortion_model="plumb_bob", distortion=(-0.1, 0.0, 0.0, 0.0, 0.0)),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["width", "height", "focal length", "distortion"],
)
def test_a_camera_that_changes_is_refused_and_not_recorded(localiser: Localiser, tmp_path: Path, other: Camera) -> None:
    feed = Feed(record=tmp_path / "drive.db3")
    feed([*camera(), *drive(N), camera(of=other)[0], *drive(2, first=N)])
    assert len(feed.published) == N + 2
    assert any("expected one camera, found intrinsics that change" in text for text in feed.said)
    feed.assert_replays(localiser)


def test_images_of_another_size_before_the_camera_is_known_do_no_harm(localiser: Localiser, tmp_path: Path) -> None:
    """A driver that begins with a small image; and one whose first CameraInfo is no camera."""
    half = cv2.resize(cv2.imdecode(np.frombuffer(LOG.frames[0].encoded(), np.uint8), 1), None, fx=0.5, fy=0.5)
    no_camera = arrival("camera_info", 0, MAKE.encode(MAKE.make("sensor_msgs/msg/CameraInfo")))
    early = [image(0, 0, encode_image(half, ".jpg", 90)), image(1, 0)]
    feed = Feed(record=tmp_path / "drive.db3")([*early, no_camera, *camera(), *drive(N)])
    assert len(feed.published) == N
    feed.assert_replays(localiser)


def truth(t_ns: int, ahead_ns: int = 0) -> Arrival:
    message = MAKE.odometry(BEGIN_NS + t_ns + ahead_ns, "map", LOG.groundtruth.at(t_ns))
    return arrival("groundtruth", t_ns, MAKE.encode(message))


def test_truth_stamped_years_ahead_does_not_end_the_truth(tmp_path: Path) -> None:
    messages = [*camera(), *drive(N)]
    wheels = [message for message in messages if message.role == "odometry"]
    for k, message in enumerate(wheels):
        messages.insert(messages.index(message), truth(message.at_ns, YEARS_NS if k % 10 == 2 else 0))
    messages.insert(0, truth(0, YEARS_NS))  # before anything else is heard
    feed = Feed(record=tmp_path / "drive.db3")(messages)
    feed.close()
    assert all(published.error_m < 0.15 for published in feed.published[1:])
    recorded = open_log(tmp_path / "drive.db3").groundtruth
    assert recorded.covers(BEGIN_NS + LOG.frames[N - 1].t_ns) and recorded.t_ns[-1] < BEGIN_NS + 10**10


@pytest.mark.parametrize("times", [pytest.param(1, marks=pytest.mark.slow), AGREEING + 1])
def test_odometry_stamped_years_ahead_does_not_stop_the_run(localiser: Localiser, tmp_path: Path, times: int) -> None:
    """At the begin, when nothing else tells the time, and while driving, also several in a row."""

    def ahead(t_ns: int) -> list[Arrival]:
        pose = MAKE.odometry(BEGIN_NS + t_ns + YEARS_NS, "odom", LOG.odometry.at(t_ns))
        return [replace(arrival("odometry", t_ns + k, MAKE.encode(pose)), wall_ns=t_ns) for k in range(times)]

    first, later = drive(5), drive(8, first=5)
    feed = Feed(record=tmp_path / "drive.db3")([*camera(), *ahead(0), *first, *ahead(first[-1].at_ns), *later])
    true = LOG.groundtruth.sampled([published.stamp_ns - BEGIN_NS for published in feed.published]).poses
    assert len(true) >= 9 and np.hypot(*(feed.poses - true)[:, :2].T).max() < 0.3
    feed.assert_replays(localiser)


def test_a_damaged_recording_is_replayed_up_to_there(localiser: Localiser, tmp_path: Path) -> None:
    bag = tmp_path / "drive.db3"
    messages = drive(N + 2)
    feed = Feed(record=bag)([*camera(), *messages])
    feed.close()
    damage(bag, "/odom", sum(each.role == "odometry" and each.at_ns <= LOG.frames[N].t_ns for each in messages))
    result = localiser("replay", bag, "--out", tmp_path / "results", "--quiet", "--no-rrd")
    assert result.exit_code == 0
    assert "cannot be read to its end: /odom at" in result.err and "expected a message that can be read" in result.err
    track = read_track(next(tmp_path.glob("results/*/1")) / "trajectory.csv")
    np.testing.assert_allclose(track.poses, feed.poses[:N], rtol=0, atol=1e-9)
    assert localiser("convert", bag, tmp_path / "folder").exit_code == 0


def damage(bag: Path, topic: str, number: int) -> None:
    """Put what is no message in the place of one on a topic, by how many of it were recorded before."""
    chosen = "SELECT messages.id FROM messages JOIN topics ON topic_id = topics.id WHERE name = ? ORDER BY 1 LIMIT 1"
    with closing(sqlite3.connect(bag)) as database, database:
        ((place,),) = database.execute(f"{chosen} OFFSET ?", (topic, number)).fetchall()
        database.execute("UPDATE messages SET data = ? WHERE id = ?", (b"\0\1\0\0no message", place))
