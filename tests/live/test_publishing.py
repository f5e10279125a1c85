"""What a live run publishes and records: committed as it goes on, ended by a full disk, replayed whatever it holds."""

import sqlite3
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from live_feed import BEGIN_NS, LOG, MAKE, Feed, arrival, camera, drive, image, odometry
from live_processes import wait_until
from live_transport import KeepingTransport
from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability
from rosbags.rosbag2 import Reader
from short_log import Localiser
from small_bag import text, texts

from localiser.camera import Camera
from localiser.errors import InputError
from localiser.geometry import compose, pose_from_ros
from localiser.live.clock import AGREEING
from localiser.live.inbox import Arrival
from localiser.live.outputs import Publisher, Recording
from localiser.ros import Frames, outputs_named
from localiser.storage import open_log, read_track
from localiser.storage.bags import RosType, stamp_of
from localiser.storage.images import encode_image


def fed(publisher: Publisher, **settings: Any) -> Feed:
    feed = Feed(**settings)
    feed.run.outputs.publisher = publisher
    return feed


def test_all_that_is_heard_goes_out_and_nothing_else() -> None:
    transport = KeepingTransport()
    fed(Publisher(transport, outputs_named()))([*camera(), *drive(4)])
    assert transport.kinds() == {f"/{name}" for name in (
        "localiser/pose", "tf", "localiser/particles", "localiser/map", "localiser/landmarks", "localiser/matches",
        "localiser/places", "localiser/path", "localiser/image/compressed", "diagnostics",
    )}  # fmt: skip
    few = KeepingTransport(heard={"/tf"})
    fed(Publisher(few, outputs_named()))([*camera(), *drive(4)])
    assert few.kinds() == {"/tf", "/localiser/pose", "/localiser/map", "/localiser/landmarks"}, (
        "what is latched goes out for those who come later"
    )
    assert few.advertised == transport.advertised


def test_names_of_topics_and_frames_can_be_changed() -> None:
    transport = KeepingTransport()
    outputs = outputs_named({"pose": "/amcl_pose", "image": None}, "/robot1")
    fed(Publisher(transport, outputs, Frames("world", "wheels")))([*camera(), *drive(3)])
    assert "/amcl_pose" in transport.kinds() and "/robot1/tf" in transport.kinds()
    assert not any("image" in topic for topic in transport.kinds())
    (transform,) = transport.messages("/robot1/tf")[-1].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("world", "wheels")
    assert transport.messages("/amcl_pose")[-1].header.frame_id == "world"


def test_the_picture_has_the_frame_of_the_robots_images() -> None:
    transport = KeepingTransport()
    frame = LOG.frames[1]
    named = MAKE.encode(MAKE.compressed(BEGIN_NS + frame.t_ns, frame.encoded(), "left_eye"))
    feed = fed(Publisher(transport, outputs_named()))([*camera(), *drive(1), arrival("image", frame.t_ns, named)])
    feed([odometry(frame.t_ns + 60_000_000)])
    first, second = transport.messages("/localiser/image/compressed")
    assert (first.header.frame_id, second.header.frame_id) == ("camera_optical_frame", "left_eye")


@pytest.mark.parametrize("late_ns", [pytest.param(0, marks=pytest.mark.slow), 60_000_000])
def test_for_every_pose_of_the_wheels_the_pose_in_the_map_is_there_within_the_tolerance(late_ns: int) -> None:
    """Nav2's part: odometry at 20 Hz, images at 5 Hz; asked at each odometry stamp for map→base as tf2 finds it.

    The newest transform reaches the stamp or later, it is never older than an image and the tolerance, and it leads
    to the true pose.
    """
    tolerance_ns = 200_000_000
    transport = KeepingTransport(heard={"/tf"})
    feed = fed(Publisher(transport, outputs_named(), tolerance_ns=tolerance_ns))
    buffer = Buffer()
    frames = LOG.frames[:40]
    step_ns = 50_000_000
    wheels = [odometry(t_ns) for t_ns in range(0, frames[-1].t_ns, step_ns)]
    images = [image(frame.t_ns, k) for k, frame in enumerate(frames)]
    asked: list[tuple[int, float]] = []
    feed(camera())
    messages = sorted([*wheels, *images], key=lambda m: m.at_ns + late_ns * (m.role == "image"))
    for message in messages:
        feed([message])
        buffer.take(transport)
        if message.role == "odometry" and feed.published:
            found = buffer.map_from_odom(BEGIN_NS + message.at_ns)
            pose = compose(found, LOG.odometry.at(message.at_ns))
            asked.append((message.at_ns, float(np.hypot(*(pose - LOG.groundtruth.at(message.at_ns))[:2]))))
    assert len(asked) > 100 and asked[0][0] < 10**9
    assert max(error for _, error in asked) < 0.1
    stamps = np.array(buffer.stamps_ns)
    assert (np.diff(stamps) == step_ns).all(), "one transform for each pose of the wheels"
    newest = [message.at_ns for message in wheels if message.at_ns >= asked[0][0]]
    assert set(BEGIN_NS + np.array(newest) + tolerance_ns) <= set(stamps), "post-dated by the tolerance"


@dataclass
class Buffer:
    """A buffer of transforms: between two of them it interpolates, beyond them it fails, as tf2 does."""

    stamps_ns: list[int] = field(default_factory=list)
    found: list[np.ndarray] = field(default_factory=list)

    def take(self, transport: KeepingTransport) -> None:
        for message in transport.messages("/tf", first=len(self.stamps_ns)):
            (stamped,) = message.transforms
            moved, turned = stamped.transform.translation, stamped.transform.rotation
            self.stamps_ns.append(stamp_of(stamped))
            self.found.append(np.array([moved.x, moved.y, 2 * np.arctan2(turned.z, turned.w)]))

    def map_from_odom(self, t_ns: int) -> np.ndarray:
        """Return map→odom in our own convention: what is applied to a pose of the wheels."""
        assert self.stamps_ns and self.stamps_ns[-1] >= t_ns, "extrapolation into the future"
        at = [np.interp(t_ns, self.stamps_ns, column) for column in np.unwrap(np.array(self.found), axis=0).T]
        x, y, turn = at
        return pose_from_ros([x, y, turn + np.pi / 2])


def test_a_stamp_years_ahead_moves_no_transform() -> None:
    transport = KeepingTransport()
    feed = fed(Publisher(transport, outputs_named()))
    feed([*camera(), *drive(4)])
    count = len(transport.messages("/tf"))
    feed([odometry_ahead(feed.now_ns)])
    assert len(transport.messages("/tf")) == count
    feed(drive(4, first=5))
    assert len(transport.messages("/tf")) > count
    assert max(stamp_of(m.transforms[0]) for m in transport.messages("/tf")) < BEGIN_NS + feed.now_ns + 10**9


def odometry_ahead(t_ns: int) -> Arrival:
    pose = MAKE.odometry(BEGIN_NS + t_ns + YEARS_NS, "odom", LOG.odometry.at(t_ns))
    return arrival("odometry", t_ns, MAKE.encode(pose))


def test_what_goes_out_is_recorded() -> None:
    """Also when nobody listens: the pose, the transform, diagnostics, and what is latched."""

    def recorded(transport: KeepingTransport) -> set[str]:
        topics: list[str] = []
        feed = fed(Publisher(transport, outputs_named(), record=lambda topic, *_: topics.append(topic)))
        feed([*camera(), *drive(4)])
        return set(topics)

    names = ("localiser/pose", "tf", "localiser/map", "localiser/landmarks", "diagnostics", "localiser/places")
    assert recorded(KeepingTransport(heard=set())) == {f"/{name}" for name in names}
    transport = KeepingTransport()
    assert recorded(transport) == transport.kinds() >= {"/localiser/image/compressed"}


def test_a_player_of_a_recording_keeps_what_was_latched(tmp_path: Path) -> None:
    """As rosbags reads the quality of service that players offer."""

    def kept(topic: str, kind: str, content: bytes) -> None:
        feed.recording.write(topic, kind, 0, content)

    feed = fed(Publisher(KeepingTransport(), outputs_named(), record=kept), record=tmp_path / "drive.db3")
    feed([*camera(), *drive(3)]).close()
    with Reader(tmp_path / "drive.db3") as bag:
        offered = {one.topic: one.ext.offered_qos_profiles for one in bag.connections}
    latched = {topic for topic, profiles in offered.items() if profiles}
    assert latched == {"/tf_static", "/localiser/log", "/localiser/map", "/localiser/landmarks", "/localiser/pose"}
    (profile,) = offered["/tf_static"]
    assert profile.durability == QosDurability.TRANSIENT_LOCAL and profile.reliability == QosReliability.RELIABLE
    assert profile.history == QosHistory.KEEP_LAST and profile.liveliness == QosLiveliness.AUTOMATIC


def test_diagnostics_tell_the_warnings_of_the_run() -> None:
    transport = KeepingTransport()
    feed = fed(Publisher(transport, outputs_named()))([*camera(), *drive(2)])
    feed([image(LOG.frames[3].t_ns, 3, b"no image"), *drive(2, first=4)])
    (status,) = transport.messages("/diagnostics")[-1].status
    values = {pair.key: pair.value for pair in status.values}
    assert values["warnings, bad image"] == "1" and float(values["p_correct"]) > 0.5


def test_a_recording_is_committed_while_it_goes_on(tmp_path: Path) -> None:
    failures: list[str] = []
    recording = Recording(tmp_path / "a.db3", failures.append)
    recording.write("/a", RosType.TEXT, 1, text("now"))
    wait_until(lambda: _readable(tmp_path / "a.db3"))
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
    wait_until(lambda: failures)
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
        return [replace(odometry_ahead(t_ns), at_ns=t_ns + k) for k in range(times)]

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
