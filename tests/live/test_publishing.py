"""What a live run publishes, over a transport that keeps what it gets."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_feed import BEGIN_NS, LOG, MAKE, Feed, arrival, camera, drive, image, odometry
from live_transport import KeepingTransport
from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability
from rosbags.rosbag2 import Reader

from localiser.geometry import compose, pose_from_ros
from localiser.live.outputs import Publisher
from localiser.ros import Frames, outputs_named
from localiser.storage.bags import typestore


def fed(publisher: Publisher, **settings: Any) -> Feed:
    feed = Feed(**settings)
    feed.run.outputs.publisher = publisher
    return feed


def stamp_of(header: Any) -> int:
    return int(header.stamp.sec * 10**9 + header.stamp.nanosec)


def test_all_that_is_heard_goes_out_and_nothing_else() -> None:
    transport = KeepingTransport()
    fed(Publisher(transport, outputs_named()))([*camera(), *drive(4)])
    assert transport.kinds() == {f"/{name}" for name in (
        "localiser/pose", "tf", "localiser/particles", "localiser/map", "localiser/landmarks", "localiser/matches",
        "localiser/places",
        "localiser/path", "localiser/image/compressed", "diagnostics",
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
            self.stamps_ns.append(stamp_of(stamped.header))
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
    assert max(stamp_of(m.transforms[0].header) for m in transport.messages("/tf")) < BEGIN_NS + feed.now_ns + 10**9


def odometry_ahead(t_ns: int) -> Any:
    import dataclasses

    message = typestore(ros1=False).deserialize_cdr(odometry(t_ns).content, "nav_msgs/msg/Odometry")
    message.header.stamp.sec += 10**8
    content = bytes(typestore(ros1=False).serialize_cdr(message, "nav_msgs/msg/Odometry"))
    return dataclasses.replace(odometry(t_ns), content=content)


def test_what_goes_out_is_recorded() -> None:
    """Also when nobody listens: the pose, the transform, diagnostics, and what is latched."""
    recorded: list[str] = []
    transport = KeepingTransport(heard=set())
    publisher = Publisher(transport, outputs_named(), record=lambda topic, msgtype, content: recorded.append(topic))
    fed(publisher)([*camera(), *drive(4)])
    assert set(recorded) == {
        "/localiser/pose",
        "/tf",
        "/localiser/map",
        "/localiser/landmarks",
        "/diagnostics",
        "/localiser/places",
    }
    heard: list[str] = []
    transport = KeepingTransport()
    publisher = Publisher(transport, outputs_named(), record=lambda topic, *rest: heard.append(topic))
    fed(publisher)([*camera(), *drive(4)])
    assert set(heard) == transport.kinds() and "/localiser/image/compressed" in heard


def test_a_player_of_a_recording_keeps_what_was_latched(tmp_path: Path) -> None:
    """As rosbags reads the quality of service that players offer."""
    feed = Feed(record=tmp_path / "drive.db3")
    feed.run.outputs.publisher = Publisher(
        KeepingTransport(),
        outputs_named(),
        record=lambda topic, kind, content: feed.recording.write(topic, kind, 0, content),
    )
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
