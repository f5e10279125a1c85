"""A ROS bag as a log: its topics are read once for times and poses; images are fetched later, one by one."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from localiser.camera import Camera, Mount
from localiser.errors import InputError
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap
from localiser.storage.bags.bag import METADATA_FILE, SUFFIXES, Bag, Message, Topic
from localiser.storage.bags.cameras import camera_of
from localiser.storage.bags.decisions import Decisions
from localiser.storage.bags.frames import FrameTree, add_all, mount_of, plain_frame
from localiser.storage.bags.images import stated_size
from localiser.storage.bags.label import FORMAT, Label, camera_of_text, label_of, map_of
from localiser.storage.bags.playback import ImagePlace, Playback
from localiser.storage.bags.poses import floor_pose
from localiser.storage.bags.topics import CAMERA_TOPIC, DECISIONS_TOPIC, MAP_TOPIC, STATE_TOPIC, Chosen, choose
from localiser.storage.cameras import load_camera
from localiser.storage.folder import start_from_file
from localiser.storage.log import Log, require_overlap

_IN_RECTIFIED = "image_rect"  # what image_proc calls images with their lens distortion undone


@dataclass(frozen=True, slots=True)
class BagReader:
    """Reads ROS bags. topics: names by what they are for. camera: a camera file, used in place of what the bag says."""

    topics: Mapping[str, str] = field(default_factory=dict)
    camera: Path | None = None

    @property
    def format(self) -> str:
        """The name of the format."""
        return "bag"

    def recognises(self, path: Path) -> bool:
        """Whether `path` is a bag's file, or the folder of a ROS 2 bag."""
        return path.suffix in SUFFIXES or (path / METADATA_FILE).exists()

    def read(self, path: Path) -> Log:
        """Return the log; the bag is read once from end to end. Raises InputError."""
        with Bag(path) as bag:
            chosen = choose(path, bag.topics, self.topics)
            content = _Content(path, chosen)
            for message in bag.messages(chosen.all):
                content.take(message)
        return _log(path, content, load_camera(self.camera) if self.camera else None)


@dataclass(slots=True, eq=False)
class _Poses:
    """Poses of one odometry topic. rows: (t_ns, x, z, heading). frame: whose poses they are."""

    rows: list[tuple[int, float, float, float]] = field(default_factory=list)
    frame: str = ""

    def take(self, message: Message, offset_ns: int = 0) -> None:
        """Add the floor part of a nav_msgs/Odometry. Raises ValueError."""
        self.rows.append((message.stamp_ns + offset_ns, *floor_pose(message.content)))
        self.frame = plain_frame(message.content.child_frame_id)

    def trajectory(self, path: Path, topic: Topic) -> Trajectory:
        """Return the poses in the order of their stamps. Raises InputError when two have the same."""
        rows = sorted(self.rows)
        times = np.array([row[0] for row in rows], dtype=np.int64)
        _require_distinct(path, topic, times)
        return Trajectory(times, np.array([row[1:] for row in rows]))


@dataclass(slots=True, eq=False)
class _Content:
    """What one pass over a bag collects."""

    path: Path
    chosen: Chosen
    images: list[ImagePlace] = field(default_factory=list)
    size: tuple[int, int] | None = None
    optical_frame: str = ""
    odometry: _Poses = field(default_factory=_Poses)
    groundtruth: _Poses = field(default_factory=_Poses)
    info: Any = None
    tree: FrameTree = field(default_factory=FrameTree)
    label: Label | None = None
    landmark_map: LandmarkMap | None = None
    camera: Camera | None = None
    decisions: Decisions | None = None
    resumed: bytes = b""

    def take(self, message: Message) -> None:
        """Keep what a message says. Raises InputError."""
        chosen = self.chosen
        try:
            if message.topic == chosen.image.name:
                self._take_image(message)
            elif message.topic == chosen.odometry.name:
                self.odometry.take(message, self._offset_ns)
            elif chosen.groundtruth is not None and message.topic == chosen.groundtruth.name:
                self.groundtruth.take(message, self._offset_ns)
            elif chosen.camera_info is not None and message.topic == chosen.camera_info.name:
                self._take_info(message.content)
            elif message.topic in {topic.name for topic in chosen.transforms}:
                add_all(self.tree, message.content.transforms)
            else:
                self._take_label(message.topic, message.content.data)
        except ValueError as error:
            raise self._error(message, error) from None

    @property
    def _offset_ns(self) -> int:
        return self.decisions.offset_ns if self.decisions is not None else 0

    def _take_label(self, topic: str, text: str) -> None:
        source = f"{self.path} {topic}"
        if topic == MAP_TOPIC:
            self.landmark_map = map_of(text, source)
        elif topic == CAMERA_TOPIC:
            self.camera = camera_of_text(text, source)
        elif topic == DECISIONS_TOPIC:
            self.decisions = self.decisions or Decisions()
            self.decisions.take(text)
        elif topic == STATE_TOPIC:
            self.resumed = b64decode(text, validate=True)
        else:
            self.label = label_of(text, source)

    def used(self) -> None:
        """Leave out what a live run did not use, if this is the recording of one."""
        if self.decisions is None:
            return
        rows = self.odometry.rows
        self.odometry.rows = [row for k, row in enumerate(rows) if k not in self.decisions.unused_odometry]
        self.images = [place for place in self.images if place.order in self.decisions.images]

    def _take_image(self, message: Message) -> None:
        size = stated_size(message.content)
        if self.size not in (None, size):
            raise ValueError(f"expected images of one size, found {self.size} and {size} pixels")
        self.size = size
        self.optical_frame = plain_frame(message.content.header.frame_id)
        last = self.images[-1] if self.images else None
        later = last.later + 1 if last is not None and last.recorded_ns == message.t_ns else 0
        stamp_ns = message.stamp_ns + self._offset_ns
        self.images.append(ImagePlace(stamp_ns, message.t_ns, len(self.images), later, self._offset_ns))

    def _take_info(self, info: Any) -> None:
        if self.info is not None and _intrinsics(self.info) != _intrinsics(info):
            raise ValueError("expected one camera, found intrinsics that change")
        self.info = info

    def _error(self, message: Message, error: ValueError) -> InputError:
        return InputError(str(error), path=self.path, field=f"{message.topic} at {message.t_ns} ns")


def _intrinsics(info: Any) -> tuple[bytes, int, int]:
    matrix = getattr(info, "k", None)
    return bytes(info.K if matrix is None else matrix), int(info.width), int(info.height)


# -- from what was collected to a log ---------------------------------------------------------------------------------


def _log(path: Path, content: _Content, given: Camera | None) -> Log:
    """Return the log that a bag holds. given: the camera in place of what the bag says of it."""
    chosen = content.chosen
    content.used()
    if not content.images or not content.odometry.rows:
        raise InputError("expected images and odometry, found a bag that is cut off", path=path)
    places = sorted(content.images, key=lambda place: place.stamp_ns)
    _require_distinct(path, chosen.image, np.array([place.stamp_ns for place in places]))
    odometry = content.odometry.trajectory(path, chosen.odometry)
    first_ns = min(int(odometry.t_ns[0]), places[0].stamp_ns)
    label = content.label or Label(format=FORMAT, name=path.resolve().stem)
    camera = given or content.camera or _camera(path, content, label.camera_name)
    starts = content.decisions.starts if content.decisions is not None else []
    blind = content.decisions.blind if content.decisions is not None else set()
    start = start_from_file(label.start, first_ns) if label.start else None
    size = (camera.width, camera.height)
    if content.size != size:
        raise InputError(
            f"expected images of {size[0]}×{size[1]} pixels, as the camera says, found {content.size}",
            path=path,
            field=chosen.image.name,
        )
    playback = Playback(path, chosen.image, size)
    truth = chosen.groundtruth
    return require_overlap(
        Log(
            name=label.name,
            path=path,
            camera=camera,
            odometry=odometry,
            frames=[playback.event(place, by_wheels=place.order not in blind) for place in places],
            landmark_map=content.landmark_map,
            start=starts[0] if starts else start,
            restarts=[start for start in starts[1:] if start is not None],
            resumed=content.resumed,
            groundtruth=content.groundtruth.trajectory(path, truth) if truth and content.groundtruth.rows else None,
            settings={f"motion.{name}": value for name, value in (label.motion or {}).items()} | (label.settings or {}),
        )
    )


def _camera(path: Path, content: _Content, name: str) -> Camera:
    """Return the camera by camera_info and transforms. Raises InputError."""
    topic = content.chosen.camera_info
    if topic is None or content.info is None:
        raise InputError(
            "expected a topic of sensor_msgs/CameraInfo, found none; give the camera with --camera FILE", path=path
        )
    rectified = _IN_RECTIFIED in content.chosen.image.name
    return camera_of(content.info, _mount(path, content), rectified=rectified, name=name, source=f"{path} {topic.name}")


def _mount(path: Path, content: _Content) -> Mount:
    try:
        return mount_of(content.tree, content.odometry.frame, content.optical_frame)
    except ValueError as error:
        raise InputError(f"{error}; give camera and mount with --camera FILE", path=path, field="tf_static") from None


def _require_distinct(path: Path, topic: Topic, times: np.ndarray[Any, Any]) -> None:
    """Raise InputError unless times that are sorted differ."""
    same = np.flatnonzero(np.diff(times) == 0)
    if len(same):
        raise InputError(f"expected stamps that differ, found {times[same[0]]} ns twice", path=path, field=topic.name)
