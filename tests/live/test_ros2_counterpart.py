"""A node of ROS 2 that nobody here wrote: zenoh-ros2-sdk, at the same router as a live run.

It sends what a robot sends, and hears what the run publishes; what was latched, also when it comes late. Its publisher
keeps nothing for those who come later, so /tf_static goes out by zenoh's own advanced publisher, with its key and
attachment.
"""

import sys
import time
from collections.abc import Iterator
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from live_feed import LOG
from live_networks import router
from live_processes import SETTINGS, START, free_endpoint, program, wait_until
from short_log import CORRIDOR

from localiser.geometry import pose_from_ros
from localiser.storage import ImageEvent
from localiser.storage.bags import ODOM, Messages, RosType, typestore

pytest.importorskip("zenoh")
sdk = pytest.importorskip("zenoh_ros2_sdk", reason="needs zenoh-ros2-sdk, of the extra `dev`")

MAKE = Messages()
PATIENCE_S = 90.0


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    """Run a router, to which the counterpart's one session belongs; return its endpoint."""
    at = free_endpoint()
    with router(at):
        yield at
        sdk.ZenohSession.get_instance().close()


def address(endpoint: str) -> dict[str, Any]:
    return {"router_ip": "127.0.0.1", "router_port": int(endpoint.rsplit(":", 1)[1]), "domain_id": 3}


def typed(msgtype: str) -> dict[str, Any]:
    """Return the definition and the hash of a type as rosbags has them: the counterpart would fetch them by git."""
    store = typestore(ros1=False)
    definition, _ = store.generate_msgdef(msgtype, ros_version=2)
    return {"msg_type": msgtype, "msg_definition": definition, "type_hash": store.hash_rihs01(msgtype)}


class Robot:
    """Sends the log that ships by the counterpart's publishers: it stands at its start until it is told to drive."""

    def __init__(self, at: dict[str, Any]) -> None:
        self.begin_ns = time.time_ns()
        names = {
            RosType.COMPRESSED: "/camera/image_raw/compressed",
            RosType.CAMERA_INFO: "/camera/camera_info",
            RosType.ODOMETRY: "/odom",
        }
        self._publishers = {kind: sdk.ROS2Publisher(name, **typed(kind), **at) for kind, name in names.items()}
        self._stop, self._go = Event(), Event()
        self._thread = Thread(target=self._drive, daemon=True)

    def latch_transforms(self, domain: int) -> Any:
        from zenoh import ext
        from zenoh_ros2_sdk.attachment import Attachment
        from zenoh_ros2_sdk.keyexpr import topic_keyexpr

        kind = typestore(ros1=False).hash_rihs01(RosType.TRANSFORMS)
        key = topic_keyexpr(domain, "/tf_static", "tf2_msgs::msg::dds_::TFMessage_", kind)
        session = sdk.ZenohSession.get_instance().session
        publisher = ext.declare_advanced_publisher(session, key, cache=ext.CacheConfig(1), publisher_detection=True)
        content = MAKE.encode(MAKE.mount(time.time_ns(), LOG.camera))
        publisher.put(content, attachment=Attachment(1, time.time_ns(), bytes(range(16))).to_bytes())
        return publisher

    def __enter__(self) -> "Robot":
        self._thread.start()
        return self

    def drive_off(self) -> None:
        """Drive from now on."""
        self._go.set()

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(PATIENCE_S)
        for publisher in self._publishers.values():
            publisher.close()

    def truth(self, stamp_ns: int) -> np.ndarray:
        return LOG.groundtruth.at(max(stamp_ns - self.begin_ns, LOG.frames[0].t_ns))

    def _drive(self) -> None:
        image = next(event for event in LOG.events(None, anywhere=True) if isinstance(event, ImageEvent))
        self.begin_ns = sys.maxsize
        while not self._go.wait(0.1):
            now_ns = time.time_ns()
            self._send(RosType.ODOMETRY, MAKE.odometry(now_ns, ODOM, LOG.odometry.at(image.t_ns)))
            self._send(RosType.CAMERA_INFO, MAKE.camera_info(now_ns, LOG.camera))
            self._send(RosType.COMPRESSED, MAKE.compressed(now_ns, image.encoded()))
        self.begin_ns = time.time_ns() + 10_000_000
        for event in LOG.events(None, anywhere=True):
            stamp_ns = self.begin_ns + event.t_ns
            if self._stop.wait(max((stamp_ns - time.time_ns()) / 1e9, 0.0)):
                return
            if isinstance(event, ImageEvent):
                self._send(RosType.CAMERA_INFO, MAKE.camera_info(stamp_ns, LOG.camera))
                self._send(RosType.COMPRESSED, MAKE.compressed(stamp_ns, event.encoded()))
            elif hasattr(event, "pose"):
                self._send(RosType.ODOMETRY, MAKE.odometry(stamp_ns, ODOM, event.pose))

    def _send(self, kind: str, message: Any) -> None:
        fields = {name: getattr(message, name) for name in message.__dataclass_fields__ if name != "__msgtype__"}
        self._publishers[kind].publish(**fields)


def test_a_live_run_and_the_counterpart_hear_each_other(endpoint: str) -> None:
    from zenoh_ros2_sdk.discovery import get_topic_names_and_types
    from zenoh_ros2_sdk.qos import QosDurability, QosProfile

    at = address(endpoint)
    poses: list[Any] = []
    transforms: list[Any] = []
    landmarks: list[Any] = []
    heard = [
        sdk.ROS2Subscriber("/localiser/pose", callback=poses.append, **typed(RosType.POSE), **at),
        sdk.ROS2Subscriber("/tf", callback=transforms.append, **typed(RosType.TRANSFORMS), **at),
    ]
    robot = Robot(at)
    latched = robot.latch_transforms(at["domain_id"])
    live = ("live", "--map", CORRIDOR / "map.yaml", "--connect", endpoint, "--domain", 3, "--start", START, *SETTINGS)
    # The counterpart asks only for the history of topics whose names have one part.
    with program(*live, "--json", "--set", "live.publish.landmarks=/landmarks") as run:
        run.wait_to_say("ready")
        with robot:
            run.wait_to_say("started at")  # the start that is stated is where the robot is now
            robot.drive_off()
            lines = run.poses(8)
            wait_until(lambda: len(poses) >= 8 and len(transforms) >= 20)
            kept = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1)
            late = sdk.ROS2Subscriber("/landmarks", callback=landmarks.append, **typed(RosType.MARKERS), qos=kept, **at)
            wait_until(lambda: landmarks)
            found = dict(get_topic_names_and_types(**at))
    for subscriber in (*heard, late):
        subscriber.close()
    latched.undeclare()
    assert len(lines) == 8
    for message in poses:
        stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        x, z, _ = pose_from_ros([message.pose.pose.position.x, message.pose.pose.position.y, 0.0])
        np.testing.assert_allclose([x, z], robot.truth(stamp_ns)[:2], atol=0.3)
    (stamped,) = transforms[-1].transforms
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("map", "odom")
    assert len(landmarks[0].markers[0].points) == 2 * len(LOG.landmark_map)
    for topic, kind in (
        ("/localiser/pose", RosType.POSE),
        ("/tf", RosType.TRANSFORMS),
        ("/landmarks", RosType.MARKERS),
    ):
        assert kind in found[topic], found
