"""Write a log as a ROS bag of any of the three kinds, whole or not at all; `read` reads it back."""

from __future__ import annotations

import glob
import heapq
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from localiser.documents import drafted, remove
from localiser.errors import InputError, OutputError
from localiser.filter import Odometry
from localiser.storage.bags.bag import CAMERA_INFO, COMPRESSED, IMU, ODOMETRY, TEXT, TRANSFORMS
from localiser.storage.bags.label import label_text
from localiser.storage.bags.messages import MAP, ODOM, Messages
from localiser.storage.bags.record import latched_quality
from localiser.storage.bags.topics import IMU_TOPIC, LOG_TOPIC, MAP_TOPIC
from localiser.storage.images import ImageEvent
from localiser.storage.log import Log, require_odometry
from localiser.storage.maps import map_text

KINDS = ("mcap", "sqlite3", "ros1")
FILE_KINDS = {".mcap": "mcap", ".db3": "sqlite3", ".bag": "ros1"}

_MOVING, _MOUNT, _INFO, _IMAGE = "/tf", "/tf_static", "/camera/camera_info", "/camera/image_raw/compressed"
WHEELS_TOPIC, _TRUTH = "/odom", "/ground_truth/odom"
_TYPES = {
    _MOVING: TRANSFORMS,
    IMU_TOPIC: IMU,
    _MOUNT: TRANSFORMS,
    _INFO: CAMERA_INFO,
    _IMAGE: COMPRESSED,
    WHEELS_TOPIC: ODOMETRY,
    _TRUTH: ODOMETRY,
}
_LATCHED = (_MOUNT, LOG_TOPIC, MAP_TOPIC)
_LAST_NS = (2**31 - 1) * 10**9  # a stamp's seconds have 32 bits


class NewBag:
    """A bag that is being written."""

    def __init__(self, writer: Any, make: Messages) -> None:
        """Take an open writer of `rosbags`. make: what makes the messages of this kind of bag."""
        self.make = make
        self._writer = writer
        self._connections: dict[str, Any] = {}

    def write(self, topic: str, msgtype: str, t_ns: int, content: bytes, *, latched: bool = False) -> None:
        """Add a message. latched: whether players of bags keep it for those who subscribe later."""
        if topic not in self._connections:
            options = _kept(self.make) if latched else {}
            self._connections[topic] = self._writer.add_connection(topic, msgtype, typestore=self.make.store, **options)
        self._writer.write(self._connections[topic], t_ns, content)


@contextmanager
def new_bag(path: Path, kind: str) -> Iterator[NewBag]:
    """Yield a bag of one of KINDS to write to; it takes its place at `path` in the end, or is removed after an error.

    A path that ends in .mcap or .db3 becomes that one file, any other of these kinds a folder, as ROS 2 records it.
    Raises OutputError when the path exists or cannot be written.
    """
    require_new(path)
    with drafted(path, is_new=True) as draft:
        folder = draft.with_suffix(".bag.part")
        try:
            folder.mkdir()
            written = folder / path.stem
            with _writer(written, kind) as writer:
                yield NewBag(writer, Messages(ros1=kind == "ros1"))
            if path.suffix in FILE_KINDS and kind != "ros1":
                (written,) = folder.glob(f"*/{glob.escape(path.stem)}.*")  # the file without its metadata.yaml
            written.replace(draft)
        except sqlite3.Error as error:
            raise OutputError(f"{path}: cannot be written: {error}") from None
        finally:
            remove(folder)


def require_new(path: Path) -> None:
    """Raise OutputError when there is something at a path."""
    if path.exists():
        raise OutputError(f"{path}: expected a path where nothing is, found something there")


def write_bag(path: Path, log: Log, kind: str, progress: Callable[[], None] = lambda: None) -> None:
    """Write a log with images as a bag of one of KINDS, calling `progress` after every image; see `new_bag`.

    Raises OutputError, InputError for a log without images or with times that ROS cannot tell, or when an image cannot
    be read.
    """
    if kind not in KINDS:
        raise InputError(f"expected {', '.join(KINDS)}, found {kind!r}", field="kind")
    if not log.has_images:
        raise InputError("expected a log with images, found edges: ROS has no message for them", path=log.path)
    require_odometry(log, "a ROS bag")
    check_times(log)
    with new_bag(path, kind) as bag:
        for topic, t_ns, message in log_messages(log, bag.make):
            write_message(bag, topic, t_ns, message)
            if topic == _IMAGE:
                progress()


def write_message(bag: NewBag, topic: str, t_ns: int, message: Any) -> None:
    """Write one of `log_messages`."""
    bag.write(topic, _TYPES.get(topic, TEXT), t_ns, bag.make.encode(message), latched=topic in _LATCHED)


def check_times(log: Log) -> None:
    """Raise InputError when a log has times that ROS cannot tell."""
    times: list[Any] = [log.odometry.t_ns, [frame.t_ns for frame in log.frames]]
    times += [log.groundtruth.t_ns] if log.groundtruth is not None else []
    for t_ns in (end for series in times if len(series) for end in (series[0], series[-1])):
        if not 0 <= t_ns <= _LAST_NS:
            raise InputError(f"expected times from 0 to {_LAST_NS} ns, as ROS has them, found {t_ns}", path=log.path)


@contextmanager
def _writer(path: Path, kind: str) -> Iterator[Any]:
    from rosbags import rosbag1, rosbag2

    if kind == "ros1":
        opened: Any = rosbag1.Writer(path)
    else:
        plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
        opened = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    with opened as writer:
        yield writer


def log_messages(log: Log, make: Messages) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, time and message of everything that the log holds, in the order of time."""
    first_ns = log.start_ns
    if not log.mount_moves:
        yield _MOUNT, first_ns, make.mount(first_ns, log.camera)
    yield LOG_TOPIC, first_ns, make.text(label_text(log))
    if log.landmark_map is not None:
        yield MAP_TOPIC, first_ns, make.text(map_text(log.landmark_map))
    poses = [] if log.groundtruth is None else zip(log.groundtruth.t_ns, log.groundtruth.poses, strict=True)
    truth = ((_TRUTH, int(t_ns), make.odometry(int(t_ns), MAP, pose)) for t_ns, pose in poses)
    yield from heapq.merge(truth, _measured(log, make), key=lambda message: message[1])


def _measured(log: Log, make: Messages) -> Iterator[tuple[str, int, Any]]:
    for event in log.events(anywhere=True):
        t_ns = event.t_ns
        if isinstance(event, Odometry):
            yield WHEELS_TOPIC, t_ns, make.odometry(t_ns, ODOM, event.pose)
        elif isinstance(event, ImageEvent):
            if log.mount_moves:
                camera = log.camera.at(event.mount)
                yield _MOVING, t_ns, make.mount(t_ns, camera)
                sigma = camera.mount.sigma
                if sigma is not None and (sigma.tilt_rad or sigma.roll_rad):
                    yield IMU_TOPIC, t_ns, make.inertial(t_ns, camera)
            yield _INFO, t_ns, make.camera_info(t_ns, log.camera)
            yield _IMAGE, t_ns, make.compressed(t_ns, event.encoded())


def _kept(make: Messages) -> dict[str, Any]:
    """Return what makes a player of bags keep a message for those who subscribe later."""
    if make.ros1:
        return {"latching": 1}
    return {"offered_qos_profiles": [latched_quality()]}
