"""What a live run recorded can be replayed, whatever the robot sent; a damaged recording up to where it is damaged."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from live_feed import BEGIN_NS, LOG, MAKE, Feed, arrival, camera, drive, image
from live_transport import KeepingTransport
from short_log import Localiser

from localiser.camera import Camera
from localiser.live.clock import AGREEING
from localiser.live.inbox import Arrival
from localiser.live.outputs import Publisher
from localiser.ros import outputs_named
from localiser.storage import open_log, read_track
from localiser.storage.images import encode_image

N = 3
YEARS_NS = 10 * 365 * 86400 * 10**9


def assert_replays_alike(localiser: Localiser, feed: Feed, bag: Path) -> None:
    """Assert that the replay of what was recorded gives the poses of the live run."""
    feed.close()
    run = localiser.replay(bag, bag.parent / "results", few=False)
    np.testing.assert_allclose(read_track(run / "trajectory.csv").poses, feed.poses, rtol=0, atol=1e-9)


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
    assert_replays_alike(localiser, feed, tmp_path / "drive.db3")


def test_images_of_another_size_before_the_camera_is_known_do_no_harm(localiser: Localiser, tmp_path: Path) -> None:
    """A driver that begins with a small image; and one whose first CameraInfo is no camera."""
    half = cv2.resize(cv2.imdecode(np.frombuffer(LOG.frames[0].encoded(), np.uint8), 1), None, fx=0.5, fy=0.5)
    no_camera = arrival("camera_info", 0, MAKE.encode(MAKE.make("sensor_msgs/msg/CameraInfo")))
    early = [image(0, 0, encode_image(half, ".jpg", 90)), image(1, 0)]
    feed = Feed(record=tmp_path / "drive.db3")([*early, no_camera, *camera(), *drive(N)])
    assert len(feed.published) == N
    assert_replays_alike(localiser, feed, tmp_path / "drive.db3")


def test_a_recording_of_all_that_went_out_replays(localiser: Localiser, tmp_path: Path) -> None:
    """The image with its edges is in it too, and is not taken for the camera's."""
    feed = Feed(record=tmp_path / "drive.db3")
    recording = feed.recording
    assert recording is not None
    feed.run.outputs.publisher = Publisher(
        KeepingTransport(),
        outputs_named(),
        record=lambda topic, msgtype, content: recording.write(topic, msgtype, 0, content),
    )
    feed([*camera(), *drive(6)])
    assert_replays_alike(localiser, feed, tmp_path / "drive.db3")


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
    assert_replays_alike(localiser, feed, tmp_path / "drive.db3")


def test_a_damaged_recording_is_replayed_up_to_there(localiser: Localiser, tmp_path: Path) -> None:
    bag = tmp_path / "drive.db3"
    messages = drive(N + 2)
    feed = Feed(record=bag)([*camera(), *messages])
    feed.close()
    damage(bag, "/odom", sum(each.role == "odometry" and each.at_ns <= LOG.frames[N].t_ns for each in messages))
    result = localiser("replay", bag, "--out", tmp_path / "results", "--quiet", "--no-rrd")
    assert result.exit_code == 2
    assert "/odom at" in result.err and "expected a message that can be read" in result.err
    assert f"The run ended after {N} of {N} frames; what was done is in" in result.err
    track = read_track(next(tmp_path.glob("results/*/1")) / "trajectory.csv")
    np.testing.assert_allclose(track.poses, feed.poses[:N], rtol=0, atol=1e-9)
    assert localiser("convert", bag, tmp_path / "folder").exit_code == 2, "others need the whole"


def damage(bag: Path, topic: str, number: int) -> None:
    """Put what is no message in the place of one on a topic, by how many of it were recorded before."""
    chosen = "SELECT messages.id FROM messages JOIN topics ON topic_id = topics.id WHERE name = ? ORDER BY 1 LIMIT 1"
    with closing(sqlite3.connect(bag)) as database, database:
        ((place,),) = database.execute(f"{chosen} OFFSET ?", (topic, number)).fetchall()
        database.execute("UPDATE messages SET data = ? WHERE id = ?", (b"\0\1\0\0no message", place))
