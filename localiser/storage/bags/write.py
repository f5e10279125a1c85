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
from localiser.storage.bags.bag import CAMERA_INFO, COMPRESSED, ODOMETRY, TEXT, TRANSFORMS
from localiser.storage.bags.label import label_text
from localiser.storage.bags.messages import MAP, ODOM, Messages
from localiser.storage.bags.topics import LOG_TOPIC, MAP_TOPIC
from localiser.storage.images import ImageEvent
from localiser.storage.log import Log, require_odometry
from localiser.storage.maps import map_text

KINDS = ("mcap", "sqlite3", "ros1")
FILE_KINDS = {".mcap": "mcap", ".db3": "sqlite3", ".bag": "ros1"}

_MOUNT, _INFO, _IMAGE = "/tf_static", "/camera/camera_info", "/camera/image_raw/compressed"
_WHEELS, _TRUTH = "/odom", "/ground_truth/odom"
_TYPES = {_MOUNT: TRANSFORMS, _INFO: CAMERA_INFO, _IMAGE: COMPRESSED, _WHEELS: ODOMETRY, _TRUTH: ODOMETRY}
_LATCHED = (_MOUNT, LOG_TOPIC, MAP_TOPIC)
_LAST_NS = (2**31 - 1) * 10**9  # a stamp's seconds have 32 bits


def write_bag(path: Path, log: Log, kind: str, progress: Callable[[], None] = lambda: None) -> None:
    """Write a log with images as a bag of one of KINDS, calling `progress` after every image.

    A path that ends in .mcap or .db3 becomes that one file, any other of these kinds a folder, as ROS 2 records it.
    Raises OutputError when the path exists or cannot be written, InputError for a log without images or with times
    that ROS cannot tell, or when an image cannot be read.
    """
    _check(log, kind)
    if path.exists():
        raise OutputError(f"{path}: expected a path where nothing is, found something there")
    with drafted(path, is_new=True) as draft:
        folder = draft.with_suffix(".bag.part")
        try:
            folder.mkdir()
            written = folder / path.stem
            with _writer(written, kind) as writer:
                _write(writer, log, Messages(ros1=kind == "ros1"), progress)
            if path.suffix in FILE_KINDS and kind != "ros1":
                (written,) = folder.glob(f"*/{glob.escape(path.stem)}.*")  # the file without its metadata.yaml
            written.replace(draft)
        except sqlite3.Error as error:
            raise OutputError(f"{path}: cannot be written: {error}") from None
        finally:
            remove(folder)


def _check(log: Log, kind: str) -> None:
    if kind not in KINDS:
        raise InputError(f"expected {', '.join(KINDS)}, found {kind!r}", field="kind")
    if not log.has_images:
        raise InputError("expected a log with images, found edges: ROS has no message for them", path=log.path)
    require_odometry(log, "a ROS bag")
    times: list[Any] = [log.odometry.t_ns, [frame.t_ns for frame in log.frames]]
    times += [log.groundtruth.t_ns] if log.groundtruth is not None else []
    for t_ns in (end for series in times for end in (series[0], series[-1])):
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


def _write(writer: Any, log: Log, make: Messages, progress: Callable[[], None]) -> None:
    connections: dict[str, Any] = {}
    for topic, t_ns, message in _messages(log, make):
        if topic not in connections:
            connections[topic] = writer.add_connection(
                topic, _TYPES.get(topic, TEXT), typestore=make.store, **_options(topic, make)
            )
        writer.write(connections[topic], t_ns, make.encode(message))
        if topic == _IMAGE:
            progress()


def _messages(log: Log, make: Messages) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, time and message of everything that the log holds, in the order of time."""
    first_ns = log.start_ns
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
            yield _WHEELS, t_ns, make.odometry(t_ns, ODOM, event.pose)
        elif isinstance(event, ImageEvent):
            yield _INFO, t_ns, make.camera_info(t_ns, log.camera)
            yield _IMAGE, t_ns, make.compressed(t_ns, event.encoded())


def _options(topic: str, make: Messages) -> dict[str, Any]:
    """Return what makes a player of bags keep a message for those who subscribe later."""
    if topic not in _LATCHED:
        return {}
    if make.ros1:
        return {"latching": 1}
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    keep, reliable, latched = QosHistory.KEEP_LAST, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL
    never = QosTime(9_223_372_036, 854_775_807)  # what ROS 2 writes for a duration without end
    live = QosLiveliness.AUTOMATIC
    return {"offered_qos_profiles": [Qos(keep, 1, reliable, latched, never, never, live, never, False)]}
