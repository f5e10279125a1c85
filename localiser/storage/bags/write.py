"""Write a log as a ROS bag of any of the three kinds, or record one while messages come; `read` reads it back."""

from __future__ import annotations

import glob
import heapq
import sqlite3
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from localiser.documents import drafted, output_errors, remove
from localiser.errors import InputError, OutputError
from localiser.filter import Odometry
from localiser.storage.bags.bag import (
    IMU_TOPIC,
    LOG_TOPIC,
    MAP_TOPIC,
    typestore,
)
from localiser.storage.bags.database import BESIDE, beside
from localiser.storage.bags.messages import MAP, ODOM, Messages
from localiser.storage.bags.recorded import label_text
from localiser.storage.files import require_new_file
from localiser.storage.images import ImageEvent
from localiser.storage.log import Log, require_odometry
from localiser.storage.maps import map_text

if TYPE_CHECKING:
    from rosbags.interfaces import Qos


KINDS = ("mcap", "sqlite3", "ros1")
FILE_KINDS = {".mcap": "mcap", ".db3": "sqlite3", ".bag": "ros1"}

_MOVING, _MOUNT, _INFO, _IMAGE = "/tf", "/tf_static", "/camera/camera_info", "/camera/image_raw/compressed"
WHEELS_TOPIC, _TRUTH = "/odom", "/ground_truth/odom"
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
            kept: dict[str, Any] = {"latching": 1} if self.make.ros1 else {"offered_qos_profiles": [latched_quality()]}
            options = kept if latched else {}
            self._connections[topic] = self._writer.add_connection(topic, msgtype, typestore=self.make.store, **options)
        self._writer.write(self._connections[topic], t_ns, content)


@contextmanager
def new_bag(path: Path, kind: str) -> Iterator[NewBag]:
    """Yield a bag of one of KINDS to write to; it takes its place at `path` in the end, or is removed after an error.

    A path that ends in .mcap or .db3 becomes that one file, any other of these kinds a folder, as ROS 2 records it.
    Raises OutputError when the path exists or cannot be written.
    """
    from rosbags import rosbag1, rosbag2

    require_new_file(path)
    with drafted(path, is_new=True) as draft:
        folder = draft.with_suffix(".bag.part")
        try:
            folder.mkdir()
            written = folder / path.stem
            plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
            options: dict[str, Any] = {} if kind == "ros1" else {"version": 9, "storage_plugin": plugin}
            with (rosbag1 if kind == "ros1" else rosbag2).Writer(written, **options) as writer:
                yield NewBag(writer, Messages(ros1=kind == "ros1"))
            if path.suffix in FILE_KINDS and kind != "ros1":
                (written,) = folder.glob(f"*/{glob.escape(path.stem)}.*")  # the file without its metadata.yaml
            written.replace(draft)
        except sqlite3.Error as error:
            raise OutputError(f"{path}: cannot be written: {error}") from None
        finally:
            remove(folder)


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
    bag.write(topic, message.__msgtype__, t_ns, bag.make.encode(message), latched=topic in _LATCHED)


def check_times(log: Log) -> None:
    """Raise InputError when a log has times that ROS cannot tell."""
    times: list[Any] = [log.odometry.t_ns, [frame.t_ns for frame in log.frames]]
    times += [log.groundtruth.t_ns] if log.groundtruth is not None else []
    for t_ns in (end for series in times if len(series) for end in (series[0], series[-1])):
        if not 0 <= t_ns <= _LAST_NS:
            raise InputError(f"expected times from 0 to {_LAST_NS} ns, as ROS has them, found {t_ns}", path=log.path)


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


SUFFIX = ".db3"

_TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
  offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema(schema_version, ros_distro) VALUES (4, 'humble');
"""


def latched_quality() -> Qos:
    """Return the quality of service of a topic that keeps its last message for late subscribers, and is reliable."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    keep, reliable, latched = QosHistory.KEEP_LAST, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL
    never = QosTime(9_223_372_036, 854_775_807)  # what ROS 2 writes for a duration without end
    return Qos(keep, 1, reliable, latched, never, never, QosLiveliness.AUTOMATIC, never, False)


class BagRecorder:
    """Writes a ROS 2 bag of SQLite, message by message as they came.

    Nothing is lost that `commit` was called for, also when the power fails: that is what a database promises, and what
    MCAP, whose index is written at the end, does not.
    """

    def __init__(self, path: Path, latched: Collection[str] = ()) -> None:
        """Make the file. latched: topics whose last message players of bags keep for those who subscribe later.

        Raises InputError for a path that does not end in .db3, OutputError.
        """
        if path.suffix != SUFFIX:
            raise InputError(
                f"expected a path that ends in {SUFFIX} (`localiser convert` makes other kinds of it), found {path}",
                field="--record",
            )
        for place in (path, *(beside(path, ending) for ending in BESIDE)):
            if place.exists():  # also what SQLite would delete
                raise OutputError(f"{place}: expected a path where nothing is, found something there")
        self._path, self._latched, self._store = path, frozenset(latched), typestore(ros1=False)
        self._topics: dict[tuple[str, str], int] = {}
        self._last_ns = 0
        with self._errors():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._database = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
            self._database.executescript(f"BEGIN;{_TABLES}COMMIT;BEGIN;")

    def write(self, topic: str, msgtype: str, t_ns: int, content: bytes) -> None:
        """Add a message as it came at `t_ns`; recorded times increase, so that a reader has the order of calls.

        Raises OutputError.
        """
        self._last_ns = max(t_ns, self._last_ns + 1)
        with self._errors():
            self._insert("messages", topic_id=self._topic(topic, msgtype), timestamp=self._last_ns, data=content)

    def commit(self) -> None:
        """Make sure of all that was written. Raises OutputError."""
        with self._errors():
            self._database.execute("COMMIT")
            self._database.execute("BEGIN")

    def close(self) -> None:
        """End the file; what could not be committed is taken back. Raises OutputError."""
        try:
            with self._errors():
                if self._database.in_transaction:
                    self._database.execute("COMMIT")
        finally:
            self._database.close()

    def _topic(self, topic: str, msgtype: str) -> int:
        key = topic, msgtype
        if key not in self._topics:
            from rosbags.rosbag2.metadata import dump_qos_v8

            digest = self._store.hash_rihs01(msgtype)
            text, _ = self._store.generate_msgdef(msgtype, ros_version=2)
            hashed: dict[str, Any] = {"type_description_hash": digest}
            definition = {"topic_type": msgtype, "encoding": "ros2msg", "encoded_message_definition": text}
            self._insert("message_definitions", **definition, **hashed)
            # As numbers: Humble reads no names, later versions read both.
            profiles = dump_qos_v8([latched_quality()]) if topic in self._latched else ""
            row = {"name": topic, "type": msgtype, "serialization_format": "cdr", "offered_qos_profiles": profiles}
            self._topics[key] = self._insert("topics", **row, **hashed)
        return self._topics[key]

    def _insert(self, table: str, **row: Any) -> int:
        """Add a row to a table; returns its number."""
        places = ", ".join("?" * len(row))
        query = f"INSERT INTO {table}({', '.join(row)}) VALUES({places})"
        return int(self._database.execute(query, list(row.values())).lastrowid or 0)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            with output_errors(self._path):
                yield
        except sqlite3.Error as error:
            raise OutputError(f"{self._path}: cannot be written: {error}") from None
