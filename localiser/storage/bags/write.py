"""Write a log as a ROS bag of any of the three kinds, with what it says of itself; `read` reads it back."""

from __future__ import annotations

import glob
import heapq
import json
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field

from localiser.camera import Camera, Mount, MountSigma
from localiser.documents import MAX_DOCUMENT_BYTES, Document, drafted, dump, is_name, parse, remove
from localiser.errors import InputError, OutputError
from localiser.filter import Anywhere, Odometry, Start
from localiser.storage.bags.bag import IMU_TOPIC, LOG_TOPIC, MAP_TOPIC
from localiser.storage.bags.database import latched_quality
from localiser.storage.bags.messages import MAP, ODOM, Messages
from localiser.storage.bags.transforms import check_start
from localiser.storage.cameras import FileModel, ShutterFile, shutter_data, shutter_of
from localiser.storage.files import require_new_file
from localiser.storage.folder import StartFile, start_data
from localiser.storage.images import ImageEvent
from localiser.storage.log import Log, require_odometry
from localiser.storage.maps import map_text

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


# -- what a log or a live run says of itself in a bag, as texts: ROS has no message for it -----------------------------
#
# A label (name, start, settings) is YAML. A decision is a line of JSON, recorded after the message that it is about, so
# that a replay of the recording uses the same messages as the run. Messages are named by their number: how many of
# their topic were recorded before them.

FORMAT: Literal["localiser-bag/1"] = "localiser-bag/1"


class Label(BaseModel):
    """Name and settings of a log in a bag; see `LogFile`."""

    model_config = FileModel

    format: Literal["localiser-bag/1"]
    name: Annotated[str, Field(min_length=1), is_name]
    camera_name: Annotated[str, is_name] = ""
    start: StartFile | None = None
    motion: dict[str, Any] | None = None
    rolling_shutter: ShutterFile | None = None
    mount_sigma: dict[Literal["yaw_rad", "height_m", "right_m", "back_m"], float] | None = None
    settings: dict[str, Any] | None = None  # everything that a live run was set to, by names such as `mcl.particles`
    topics: dict[str, str] | None = None  # what a live run listened to, by what it is for, such as `image`


def document_of(text: str, source: str) -> Document:
    """Return the YAML document that a message holds. Raises InputError; ValueError when it is too long."""
    if len(text) > MAX_DOCUMENT_BYTES:
        raise ValueError(f"expected at most {MAX_DOCUMENT_BYTES} characters, found {len(text)}")
    return parse(text, source)


def label_text(log: Log) -> str:
    """Return the label of a log as text."""
    data: dict[str, Any] = {"format": FORMAT, "name": log.name, "camera_name": log.camera.name}
    if log.start is not None:
        data["start"] = start_data(log.start)
    if motion := motion_settings(log):
        data["motion"] = motion
    if log.camera.shutter is not None:
        data["rolling_shutter"] = shutter_data(log.camera.shutter)
    if sigma := _mount_sigma(log):
        data["mount_sigma"] = sigma
    return dump(data)


def _mount_sigma(log: Log) -> dict[str, float]:
    """Return the sigmas of the mount that no message of ROS can state. Raises InputError unless all images share them.

    Those of tilt and roll stand beside the orientation of an inertial sensor.
    """
    found = {}
    mounts = [image.mount for image in log.images]
    for name in ("yaw_rad", "height_m", "right_m", "back_m"):
        stated: set[float | None] = {getattr(mount.sigma, name) if mount and mount.sigma else None for mount in mounts}
        if len(stated) > 1:
            problem = f"expected one sigma of the mount's {name} for all images, which is what a bag can hold"
            raise InputError(f"{problem}, found {len(stated)}", path=log.path, field="images")
        if (sigma := stated.pop() if stated else None) is not None:
            found[name] = float(sigma)
    return found


def with_sigma(mounts: Sequence[Mount | None], label: Label) -> Sequence[Mount | None]:
    """Return the mounts with the sigmas that the label states."""
    sigmas: dict[str, Any] = {str(name): sigma for name, sigma in (label.mount_sigma or {}).items()}
    if not sigmas:
        return mounts
    return [mount and replace(mount, sigma=replace(mount.sigma or MountSigma(), **sigmas)) for mount in mounts]


def with_label(camera: Camera, label: Label) -> Camera:
    """Return the camera with what no message of ROS says of it: its name, and how its shutter rolls."""
    shutter = shutter_of(label.rolling_shutter, camera.height, Document(None, {})) or camera.shutter
    return replace(camera, name=camera.name or label.camera_name, shutter=shutter)


def live_label_text(name: str, settings: Mapping[str, Any], topics: Mapping[str, str]) -> str:
    """Return the label of a live run as text: it starts where its decisions say, with these settings.

    topics: what it listens to, by what that is for.
    """
    return dump({"format": FORMAT, "name": name, "settings": dict(settings), "topics": dict(topics)})


def motion_settings(log: Log) -> dict[str, Any]:
    """Return what a log says of its robot's odometry, as a log folder names it."""
    return {name.removeprefix("motion."): value for name, value in log.settings.items() if name.startswith("motion.")}


_LATEST_NS = 2**62
_MOST = 10**8  # messages of a topic; larger numbers could be chosen to fall into one place of a set


def image_decision(number: int, t_ns: int, unused: str = "", *, by_wheels: bool = True) -> str:
    """Return that an image was weighed, or why not. t_ns: its time, by which people find it.

    by_wheels: whether the wheels said how the robot came there, or its edges had to, because the wheels were silent.
    """
    data: dict[str, Any] = {"image": number, "t_ns": t_ns, "used": not unused}
    data |= {"why": unused} if unused else {}
    return json.dumps(data | ({} if by_wheels else {"by_wheels": False}))


def odometry_decision(number: int, t_ns: int, why: str) -> str:
    """Return why a pose of the wheels was not used; all others were."""
    return json.dumps({"odometry": number, "t_ns": t_ns, "used": False, "why": why})


def clock_decision(offset_ns: int) -> str:
    """Return what is added to all stamps from here on, because the robot's clock has jumped."""
    return json.dumps({"clock": offset_ns})


def start_decision(start: Start) -> str:
    """Return that the filter was started, exactly as it was."""
    return json.dumps({"start": start.t_ns, "mean": start.mean.tolist(), "cov": start.cov.tolist()})


def anywhere_decision(t_ns: int | None = None) -> str:
    """Return that the robot was looked for on the whole map: at the beginning, or from a later time on."""
    return json.dumps({"start": None} if t_ns is None else {"anywhere": t_ns})


@dataclass(slots=True, eq=False)
class Decisions:
    """The decisions of a recording, taken in their order.

    images, unused_odometry: by number. blind: images that were weighed without wheels. starts: the first is None where
    the robot was looked for. offset_ns: what to add to the stamps that are read now. any: whether
    there is any decision at all.
    """

    images: set[int] = field(default_factory=set)
    blind: set[int] = field(default_factory=set)
    unused_odometry: set[int] = field(default_factory=set)
    starts: list[Start | Anywhere | None] = field(default_factory=list)
    offset_ns: int = 0
    any: bool = False

    def take(self, text: str) -> None:
        """Take one decision. Raises ValueError."""
        self.any = True
        try:
            data = json.loads(text)
        except RecursionError as error:
            raise ValueError("expected a decision") from error
        match data:
            case {"image": int(number), "used": bool(used)} if 0 <= number < _MOST:
                if used:
                    self.images.add(number)
                if data.get("by_wheels") is False:
                    self.blind.add(number)
            case {"odometry": int(number), "used": False} if 0 <= number < _MOST:
                self.unused_odometry.add(number)
            case {"clock": int(offset_ns)} if abs(offset_ns) < _LATEST_NS:
                self.offset_ns = offset_ns
            case {"start": int(t_ns)} if 0 <= t_ns < _LATEST_NS:
                self.starts.append(_start(t_ns, data))
            case {"anywhere": int(t_ns)} if 0 <= t_ns < _LATEST_NS and self.starts:
                self.starts.append(Anywhere(t_ns))
            case {"start": None} if not self.starts:
                self.starts.append(None)
            case _:
                raise ValueError("expected a decision on an image, odometry, the clock or a start")


def _start(t_ns: int, data: Mapping[str, Any]) -> Start:
    mean, cov = (np.array(data.get(name), dtype=np.float64) for name in ("mean", "cov"))
    if mean.shape != (3,) or cov.shape != (3, 3) or not (np.isfinite(mean).all() and np.isfinite(cov).all()):
        raise ValueError("expected a start of a pose and its covariance")
    check_start(mean, cov)
    return Start(t_ns, mean, cov)
