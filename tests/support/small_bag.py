"""Bags made message by message, as other programs might have recorded them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2

from localiser.storage.bags import Messages, RosType
from localiser.storage.bags.bag import Bag

KINDS = pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
NAMES = {"mcap": "bag", "sqlite3": "bag", "ros1": "x.bag"}
WIDTH, HEIGHT = 8, 6
OPTICAL = (-0.5, 0.5, -0.5, 0.5)  # quaternion of an optical frame that looks straight ahead, tilted by nothing


class Recorder:
    """Writes messages to an open bag."""

    def __init__(self, writer: Any, ros1: bool) -> None:
        messages = Messages(ros1=ros1)
        self.writer, self.ros1, self.store, self.make = writer, ros1, messages.store, messages.make
        self.connections: dict[tuple[str, str], Any] = {}

    def header(self, t_ns: int, frame: str) -> dict[str, Any]:
        return {"stamp": {"sec": t_ns // 10**9, "nanosec": t_ns % 10**9}, "frame_id": frame}

    def send(self, topic: str, msgtype: str, t_ns: int, **fields: Any) -> None:
        """Write a message, recorded at t_ns; what is left out is zero or empty."""
        key = topic, msgtype
        if key not in self.connections:
            self.connections[key] = self.writer.add_connection(topic, msgtype, typestore=self.store)
        encode = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.writer.write(self.connections[key], t_ns, encode(self.make(msgtype, **fields), msgtype))

    def image(self, t_ns: int, *, topic: str = "/cam/image", recorded_ns: int | None = None, **fields: Any) -> None:
        grey = np.full((HEIGHT, WIDTH), t_ns % 251, dtype=np.uint8)
        fields = {"width": WIDTH, "height": HEIGHT, "encoding": "mono8", "step": WIDTH, "data": grey.ravel()} | fields
        recorded = t_ns if recorded_ns is None else recorded_ns
        self.send(topic, RosType.IMAGE, recorded, header=self.header(t_ns, "optical"), **fields)

    def images(self, count: int = 4, **fields: Any) -> None:
        """Write images, ten a second."""
        for step in range(count):
            self.image(step * 10**8, **fields)

    def compressed(self, t_ns: int, data: bytes, topic: str = "/cam/image/compressed") -> None:
        pixels = np.frombuffer(data, dtype=np.uint8)
        self.send(topic, RosType.COMPRESSED, t_ns, header=self.header(t_ns, "optical"), format="jpeg", data=pixels)

    def info(self, t_ns: int = 0, topic: str = "/cam/camera_info", focal: float = 10.0, **fields: Any) -> None:
        matrix = np.array([focal, 0, 3.5, 0, focal, 2.5, 0, 0, 1.0])
        names = "K" if self.ros1 else "k"
        fields = {"width": WIDTH, "height": HEIGHT, "distortion_model": "plumb_bob", names: matrix} | fields
        self.send(topic, RosType.CAMERA_INFO, t_ns, header=self.header(t_ns, "optical"), **fields)

    def odometry(
        self,
        t_ns: int,
        x: float = 0.0,
        *,
        topic: str = "/odom",
        base: str = "base_link",
        recorded_ns: int | None = None,
        **turned: float,
    ) -> None:
        pose = {"pose": {"position": {"x": x}, "orientation": {"w": 1.0} | turned}}
        recorded = t_ns if recorded_ns is None else recorded_ns
        self.send(topic, RosType.ODOMETRY, recorded, header=self.header(t_ns, "odom"), child_frame_id=base, pose=pose)

    def pose(self, t_ns: int, x: float, topic: str, kind: str) -> None:
        """Write a pose as PoseStamped, PoseWithCovarianceStamped or TransformStamped."""
        pose: dict[str, Any] = {"position": {"x": x}, "orientation": {"w": 1.0}}
        fields = {
            "PoseStamped": {"pose": pose},
            "PoseWithCovarianceStamped": {"pose": {"pose": pose}},
            "TransformStamped": {"transform": {"translation": {"x": x}, "rotation": {"w": 1.0}}},
        }
        self.send(topic, f"geometry_msgs/msg/{kind}", t_ns, header=self.header(t_ns, "map"), **fields[kind])

    def transform(
        self,
        parent: str,
        child: str,
        translation: tuple[float, float, float],
        rotation: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0),
        topic: str = "/tf_static",
        t_ns: int = 0,
        msgtype: str = RosType.TRANSFORMS,
    ) -> None:
        moved = dict(zip("xyz", map(float, translation), strict=True))
        turned = dict(zip("xyzw", map(float, rotation), strict=True))
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(t_ns, parent),
            child_frame_id=child,
            transform={"translation": moved, "rotation": turned},
        )
        self.send(topic, msgtype, t_ns, transforms=[stamped])

    def mount(self) -> None:
        """Write where the camera is on the robot."""
        self.transform("base_link", "optical", (0.1, 0.0, 0.7), OPTICAL)

    def steps(self, count: int = 3, base: str = "base_link", **image: Any) -> None:
        """Write odometry and an image, ten times a second."""
        for step in range(count):
            self.odometry(step * 10**8, base=base)
            self.image(step * 10**8, **image)

    def setting(self) -> None:
        """Write what every log needs beside images: camera, mount, odometry for a second."""
        self.info()
        self.mount()
        for step in range(11):
            self.odometry(step * 10**8, 0.01 * step)


@contextmanager
def recording(path: Path, kind: str = "mcap") -> Iterator[Recorder]:
    """Make a new bag of a kind."""
    if kind == "ros1":
        with rosbag1.Writer(path) as writer:
            yield Recorder(writer, ros1=True)
    else:
        plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
        with rosbag2.Writer(path, version=9, storage_plugin=plugin) as two:
            yield Recorder(two, ros1=False)


def bag(path: Path, record: Callable[[Recorder], None], kind: str = "mcap") -> Path:
    """Make a bag with the usual setting and what `record` adds; returns its path."""
    with recording(path, kind) as recorder:
        recorder.setting()
        record(recorder)
    return path


MAKE = Messages()


def text(words: str) -> bytes:
    return MAKE.encode(MAKE.text(words))


def texts(path: Path) -> list[str]:
    """Return the texts of a bag that holds texts only."""
    with Bag(path) as bag:
        return [message.content.data for message in bag.messages(bag.topics)]
