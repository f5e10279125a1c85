"""A log as a ROS bag: what `read` reads, in any of the three kinds, written whole or not at all."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from localiser.errors import InputError, OutputError
from localiser.filter import Odometry
from localiser.storage.bags.bag import CAMERA_INFO, COMPRESSED, ODOMETRY, TEXT, TRANSFORMS
from localiser.storage.bags.label import label_text, map_text
from localiser.storage.bags.messages import MAP, ODOM, Messages
from localiser.storage.bags.topics import LOG_TOPIC, MAP_TOPIC
from localiser.storage.files import output_errors
from localiser.storage.images import ImageEvent
from localiser.storage.log import Log

KINDS = ("mcap", "sqlite3", "ros1")
FILE_KINDS = {".mcap": "mcap", ".db3": "sqlite3", ".bag": "ros1"}

TOPICS = {
    "/tf_static": TRANSFORMS,
    "/camera/camera_info": CAMERA_INFO,
    "/camera/image_raw/compressed": COMPRESSED,
    "/odom": ODOMETRY,
    "/ground_truth/odom": ODOMETRY,
    LOG_TOPIC: TEXT,
    MAP_TOPIC: TEXT,
}
LATCHED = ("/tf_static", LOG_TOPIC, MAP_TOPIC)
_NS = 1_000_000_000
_LAST_NS = (2**31 - 1) * _NS  # a stamp's seconds have 32 bits


def write_bag(path: Path, log: Log, kind: str, progress: Callable[[], None] = lambda: None) -> None:
    """Write a log with images as a bag of one of KINDS, calling `progress` after every image.

    A path that ends in .mcap or .db3 becomes that one file, any other of these kinds a folder, as ROS 2 records it.
    Raises OutputError when the path exists or cannot be
    written, InputError for a log without images or with times that ROS cannot tell, or when an image cannot be read.
    """
    _check(log)
    if path.exists():
        raise OutputError(f"{path}: expected a path where nothing is, found something there")
    draft = path.with_name(f".{path.name}.part")
    with output_errors(path):
        shutil.rmtree(draft, ignore_errors=True)
        draft.mkdir(parents=True)
    try:
        with output_errors(path), _sqlite_errors(path):
            with _writer(draft / path.stem, kind) as writer:
                _Bagger(writer, ros1=kind == "ros1").write(log, progress)
            written = draft / path.stem
            if path.suffix in FILE_KINDS and kind != "ros1":
                (written,) = written.glob(f"{path.stem}.*")  # the file alone, without its metadata.yaml
            written.replace(path)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


@contextmanager
def _sqlite_errors(path: Path) -> Iterator[None]:
    """Turn what SQLite says about writing `path` into an OutputError."""
    try:
        yield
    except sqlite3.Error as error:
        raise OutputError(f"{path}: cannot be written: {error}") from None


def _check(log: Log) -> None:
    if not log.has_images:
        raise InputError("expected a log with images, found edges: ROS has no message for them", path=log.path)
    ends = [log.odometry.t_ns[0], log.odometry.t_ns[-1], log.frames[0].t_ns, log.frames[-1].t_ns]
    ends += [] if log.groundtruth is None else [log.groundtruth.t_ns[0], log.groundtruth.t_ns[-1]]
    for t_ns in ends:
        if not 0 <= t_ns <= _LAST_NS:
            raise InputError(f"expected times from 0 to {_LAST_NS} ns, as ROS has them, found {t_ns}", path=log.path)


@contextmanager
def _writer(path: Path, kind: str) -> Iterator[Any]:
    from rosbags import rosbag1, rosbag2

    if kind not in KINDS:
        raise InputError(f"expected {', '.join(KINDS)}, found {kind!r}", field="kind")
    if kind == "ros1":
        with rosbag1.Writer(path) as writer:
            yield writer
    else:
        plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
        with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
            yield writer


class _Bagger:
    """Turns what a log holds into messages of ROS 1 or ROS 2, and writes them."""

    def __init__(self, writer: Any, *, ros1: bool) -> None:
        self._writer = writer
        self._messages = Messages(ros1=ros1)
        self._connections: dict[str, Any] = {}

    def write(self, log: Log, progress: Callable[[], None]) -> None:
        """Write everything in the order of time."""
        make, first_ns = self._messages, log.start_ns
        self._send("/tf_static", first_ns, make.mount(first_ns, log.camera))
        self._send(LOG_TOPIC, first_ns, make.text(label_text(log)))
        if log.landmark_map is not None:
            self._send(MAP_TOPIC, first_ns, make.text(map_text(log.landmark_map)))
        truth = [] if log.groundtruth is None else list(zip(log.groundtruth.t_ns, log.groundtruth.poses, strict=True))
        truth.reverse()
        for event in log.events():
            while truth and truth[-1][0] <= event.t_ns:
                self._pose("/ground_truth/odom", MAP, *truth.pop())
            if isinstance(event, Odometry):
                self._pose("/odom", ODOM, event.t_ns, event.pose)
            elif isinstance(event, ImageEvent):
                self._send("/camera/camera_info", event.t_ns, make.camera_info(event.t_ns, log.camera))
                self._send("/camera/image_raw/compressed", event.t_ns, make.compressed(event.t_ns, event.encoded()))
                progress()
        while truth:
            self._pose("/ground_truth/odom", MAP, *truth.pop())

    def _pose(self, topic: str, frame: str, t_ns: int, pose: Any) -> None:
        self._send(topic, int(t_ns), self._messages.odometry(int(t_ns), frame, pose))

    def _latched(self) -> dict[str, Any]:
        """Return what makes a player of bags hold a message for those who subscribe later."""
        if self._messages.ros1:
            return {"latching": 1}
        from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

        never = QosTime(9_223_372_036, 854_775_807)  # what ROS 2 writes for a duration without end
        qos = Qos(
            QosHistory.KEEP_LAST,
            1,
            QosReliability.RELIABLE,
            QosDurability.TRANSIENT_LOCAL,
            never,
            never,
            QosLiveliness.AUTOMATIC,
            never,
            avoid_ros_namespace_conventions=False,
        )
        return {"offered_qos_profiles": [qos]}

    def _send(self, topic: str, t_ns: int, message: Any) -> None:
        if topic not in self._connections:
            options = self._latched() if topic in LATCHED else {}
            self._connections[topic] = self._writer.add_connection(
                topic, TOPICS[topic], typestore=self._messages.store, **options
            )
        self._writer.write(self._connections[topic], t_ns, self._messages.encode(message))
