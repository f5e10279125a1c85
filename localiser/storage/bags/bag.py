"""Open a bag of any kind: which topics it has, and the messages in the order of recording.

Messages are decoded by the definitions that ROS ships, never by those that a bag carries: a bag could define anything.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from localiser.errors import InputError, LocaliserError
from localiser.storage.bags.frames import stamp_of
from localiser.storage.bags.guarded import rosbag1_reader, rosbag2_reader
from localiser.storage.bags.limits import Allowance, check_files, check_topics, message_unpacker

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, ODOMETRY = "sensor_msgs/msg/CameraInfo", "nav_msgs/msg/Odometry"
IMU = "sensor_msgs/msg/Imu"
TRANSFORMS, TEXT = "tf2_msgs/msg/TFMessage", "std_msgs/msg/String"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSES, PATH = "geometry_msgs/msg/PoseArray", "nav_msgs/msg/Path"
CLOCK = "rosgraph_msgs/msg/Clock"
MARKERS, DIAGNOSTICS = "visualization_msgs/msg/MarkerArray", "diagnostic_msgs/msg/DiagnosticArray"

METADATA_FILE = "metadata.yaml"
ROS1_SUFFIX = ".bag"
SUFFIXES = (ROS1_SUFFIX, ".mcap", ".db3")
MOST_TRANSFORMS_BYTES = 2**20  # of a message; thousands of transforms, each of which takes 2 kB once it is read


@dataclass(frozen=True, slots=True, eq=False)
class Topic:
    """A topic of a bag: name, type of its messages, and how many there are."""

    name: str
    msgtype: str
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """A message as recorded. t_ns: when it was recorded, which is not when it was measured. content: its fields."""

    topic: str
    msgtype: str
    t_ns: int
    content: Any

    @property
    def stamp_ns(self) -> int:
        """When it was measured, by its header."""
        return stamp_of(self.content)


class Bag:
    """A bag that is open for reading; to be used as a context manager, or closed."""

    def __init__(self, path: Path) -> None:
        """Open a bag and read which topics it has. Raises InputError."""
        self.path = path
        is_ros1 = path.suffix == ROS1_SUFFIX
        self._store = typestore(ros1=is_ros1)
        self._decode = self._store.deserialize_ros1 if is_ros1 else self._store.deserialize_cdr
        if not path.exists():
            raise InputError("no such bag", path=path)
        check_files(path, METADATA_FILE)
        with bag_errors(path), Allowance(path).in_force():
            self._reader: Any = (rosbag1_reader() if is_ros1 else rosbag2_reader())(path)
            self._reader.open()
        try:
            with bag_errors(path):
                check_topics(len(self._reader.connections))
                self._unpack = message_unpacker(self._reader)
                self._connections: list[Connection] = [_checked(found) for found in self._reader.connections]
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the bag."""
        with suppress(Exception):  # a damaged bag that is being left anyway
            self._reader.close()

    @property
    def topics(self) -> list[Topic]:
        """The topics, by name; a topic that several nodes published on is one."""
        counts: Counter[tuple[str, str]] = Counter()
        for found in self._connections:
            counts[found.topic, found.msgtype] += found.msgcount
        return [Topic(*key, count) for key, count in sorted(counts.items())]

    def messages(self, topics: Collection[Topic], from_ns: int | None = None) -> Iterator[Message]:
        """Yield the messages of some topics in the order of recording, from a time of recording on.

        Raises InputError for a message that its type cannot be read from.
        """
        wanted = {(topic.name, topic.msgtype) for topic in topics}
        connections = [found for found in self._connections if (found.topic, found.msgtype) in wanted]
        if not connections:
            return
        with bag_errors(self.path):
            read = Allowance(self.path)
            found = self._reader.messages(connections, start=from_ns)
            for connection, t_ns, packed in Allowance(self.path).over(found):
                if (connection.topic, connection.msgtype) not in wanted:
                    raise ValueError("two topics share a number, so that their messages cannot be told apart")
                with bag_errors(self.path, f"{connection.topic} at {t_ns} ns"):
                    data = self._unpack(packed)
                    read.spend(len(data))
                    if connection.msgtype == TRANSFORMS and len(data) > MOST_TRANSFORMS_BYTES:
                        raise ValueError(f"expected at most {MOST_TRANSFORMS_BYTES} bytes, found {len(data)}")
                    content = self._decode(data, connection.msgtype)
                yield Message(connection.topic, connection.msgtype, int(t_ns), content)


def _checked(connection: Connection) -> Connection:
    """Return the connection if its topic has a name, a type and a number of messages.

    Damaged metadata or a damaged database may hold anything there.
    """
    for text in (connection.topic, connection.msgtype):
        if not isinstance(text, str) or not text.isprintable():
            raise ValueError("a topic has no name or no type")
    if not isinstance(connection.msgcount, int) or connection.msgcount < 0:
        raise ValueError("a topic has no number of messages")
    return connection


@contextmanager
def bag_errors(path: Path, field: str | None = None) -> Iterator[None]:
    """Turn whatever a damaged bag makes `rosbags` raise into an InputError.

    It promises no list of exceptions: bytes that were changed show up as errors of struct, lz4, sqlite, numpy or YAML.
    """
    try:
        yield
    except (LocaliserError, GeneratorExit):
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        what = "message" if field else "ROS bag"
        raise InputError(f"expected a {what} that can be read: {reason}", path=path, field=field) from None


_MORE_TYPES = {
    TRANSFORMS: ["geometry_msgs/TransformStamped[] transforms"],
}
"""Messages by their fields, where the definitions that ROS ships lack them."""


@cache
def typestore(*, ros1: bool) -> Typestore:
    """Return the message definitions of ROS 1 Noetic or ROS 2 Humble; the messages read here are the same in all."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for msgtype, fields in _MORE_TYPES.items():
        if msgtype not in store.fielddefs:
            store.register(get_types_from_msg("\n".join(fields), msgtype))
    return store
