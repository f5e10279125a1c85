"""Read a ROS bag as a log: one pass collects times and poses, images are fetched later, one by one."""

from __future__ import annotations

from base64 import b64decode
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from localiser.camera import Camera
from localiser.documents import validate
from localiser.errors import InputError
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap
from localiser.storage.bags.bag import METADATA_FILE, SUFFIXES, Bag, Message, Topic
from localiser.storage.bags.cameras import camera_of
from localiser.storage.bags.decisions import Decisions
from localiser.storage.bags.frames import FrameTree, floor_pose, mount_of, plain_frame
from localiser.storage.bags.images import stated_size
from localiser.storage.bags.label import FORMAT, Label, document_of
from localiser.storage.bags.playback import ImagePlace, Playback
from localiser.storage.bags.topics import CAMERA_TOPIC, DECISIONS_TOPIC, LOG_TOPIC, MAP_TOPIC, STATE_TOPIC, choose
from localiser.storage.cameras import camera_from_document, read_camera
from localiser.storage.folder import start_from_file
from localiser.storage.images import check_size
from localiser.storage.log import Log, ReadOptions, require_overlap
from localiser.storage.maps import map_from_document

_IN_RECTIFIED = "image_rect"  # what image_proc calls images with their lens distortion undone


class BagReader:
    """Reads ROS bags."""

    format, looks_like, options = "bag", "a ROS bag", ("topics", "camera")

    def recognises(self, path: Path) -> bool:
        """Whether `path` is a bag's file, or the folder of a ROS 2 bag."""
        return path.suffix in SUFFIXES or (path / METADATA_FILE).exists()

    def read(self, path: Path, options: ReadOptions) -> Log:
        """Return the log; the bag is read once from end to end. Raises InputError."""
        with Bag(path) as bag:
            roles = choose(path, bag.topics, options.topics)
            content = _Content(path, {topic.name: role for topic, role in roles.items()})
            for message in bag.messages(roles):
                content.take(message)
        image = next(topic for topic, role in roles.items() if role == "image")
        return _log(content, image, read_camera(options.camera) if options.camera else None)


@dataclass(slots=True, eq=False)
class _Poses:
    """Poses of one odometry topic. rows: (t_ns, x, z, heading). frame: whose poses they are."""

    rows: list[tuple[int, float, float, float]] = field(default_factory=list)
    topic: str = ""
    frame: str = ""

    def take(self, message: Message, offset_ns: int) -> None:
        """Add the floor part of a nav_msgs/Odometry. Raises ValueError."""
        self.rows.append((message.stamp_ns + offset_ns, *floor_pose(message.content)))
        self.topic, self.frame = message.topic, plain_frame(message.content.child_frame_id)

    def trajectory(self, path: Path) -> Trajectory:
        """Return the poses in the order of their stamps. Raises InputError when two have the same."""
        rows = sorted(self.rows)
        times = _distinct([row[0] for row in rows], path, self.topic)
        return Trajectory(times, np.array([row[1:] for row in rows]))


@dataclass(slots=True, eq=False)
class _Content:
    """What one pass over a bag collects. roles: what each topic is for, by its name."""

    path: Path
    roles: dict[str, str]
    images: list[ImagePlace] = field(default_factory=list)
    size: tuple[int, int] | None = None
    optical_frame: str = ""
    odometry: _Poses = field(default_factory=_Poses)
    groundtruth: _Poses = field(default_factory=_Poses)
    info: Message | None = None
    tree: FrameTree = field(default_factory=FrameTree)
    label: Label | None = None
    landmark_map: LandmarkMap | None = None
    camera: Camera | None = None
    decisions: Decisions = field(default_factory=Decisions)
    resumed: bytes = b""

    def take(self, message: Message) -> None:
        """Keep what a message says. Raises InputError."""
        try:
            self._take(self.roles[message.topic], message)
        except ValueError as error:
            field = f"{message.topic} at {message.t_ns} ns"
            raise InputError(str(error), path=self.path, field=field) from None

    def _take(self, role: str, message: Message) -> None:
        content, offset_ns = message.content, self.decisions.offset_ns
        if role == "image":
            self._take_image(message, offset_ns)
        elif role == "odometry":
            self.odometry.take(message, offset_ns)
        elif role == "groundtruth":
            self.groundtruth.take(message, offset_ns)
        elif role == "camera_info":
            if self.info is not None and _intrinsics(self.info.content) != _intrinsics(content):
                raise ValueError("expected one camera, found intrinsics that change")
            self.info = message
        elif role == "transforms":
            self.tree.add_all(content.transforms)
        elif role == DECISIONS_TOPIC:
            self.decisions.take(content.data)
        elif role == STATE_TOPIC:
            self.resumed = b64decode(content.data, validate=True)
        else:
            document = document_of(content.data, f"{self.path} {role}")
            if role == LOG_TOPIC:
                self.label = validate(document, Label)
            elif role == MAP_TOPIC:
                self.landmark_map = map_from_document(document)
            elif role == CAMERA_TOPIC:
                self.camera = camera_from_document(document)

    def _take_image(self, message: Message, offset_ns: int) -> None:
        size = stated_size(message.content)
        if self.size not in (None, size):
            raise ValueError(f"expected images of one size, found {self.size} and {size} pixels")
        self.size = size
        self.optical_frame = plain_frame(message.content.header.frame_id)
        last = self.images[-1] if self.images else None
        later = last.later + 1 if last is not None and last.recorded_ns == message.t_ns else 0
        self.images.append(ImagePlace(message.stamp_ns + offset_ns, message.t_ns, len(self.images), later, offset_ns))


def _intrinsics(info: Any) -> tuple[bytes, int, int]:
    matrix = getattr(info, "k", None)
    return bytes(info.K if matrix is None else matrix), int(info.width), int(info.height)


# -- from what was collected to a log ---------------------------------------------------------------------------------


def _log(content: _Content, topic: Topic, given: Camera | None) -> Log:
    """Return the log that a bag holds. topic: of the images. given: the camera in place of what the bag says of it."""
    path, decisions = content.path, content.decisions
    if decisions.any:  # the recording of a live run: what that did not use is left out
        rows, unused = content.odometry.rows, decisions.unused_odometry
        content.odometry.rows = [row for k, row in enumerate(rows) if k not in unused]
        content.images = [place for place in content.images if place.order in decisions.images]
    if not content.images or not content.odometry.rows or content.size is None:
        raise InputError("expected images and odometry, found a bag that is cut off", path=path)
    places = sorted(content.images, key=lambda place: place.stamp_ns)
    _distinct([place.stamp_ns for place in places], path, topic.name)
    odometry = content.odometry.trajectory(path)
    label = content.label or Label(format=FORMAT, name=path.resolve().stem)
    camera = given or content.camera or _camera(content, topic, label.camera_name)
    first_ns = min(int(odometry.t_ns[0]), places[0].stamp_ns)
    starts = decisions.starts or [start_from_file(label.start, first_ns) if label.start else None]
    size = (camera.width, camera.height)
    check_size(path, content.size, size, topic.name)
    playback = Playback(path, topic, size)
    log = Log(
        name=label.name,
        path=path,
        camera=camera,
        odometry=odometry,
        frames=[playback.event(place, by_wheels=place.order not in decisions.blind) for place in places],
        landmark_map=content.landmark_map,
        start=starts[0],
        restarts=[start for start in starts[1:] if start is not None],
        resumed=content.resumed,
        groundtruth=content.groundtruth.trajectory(path) if content.groundtruth.rows else None,
        settings={f"motion.{name}": value for name, value in (label.motion or {}).items()} | (label.settings or {}),
    )
    return require_overlap(log)


def _camera(content: _Content, topic: Topic, name: str) -> Camera:
    """Return the camera by camera_info and transforms. Raises InputError."""
    path, info = content.path, content.info
    if info is None:
        problem = "expected a topic of sensor_msgs/CameraInfo, found none; give the camera with --camera FILE"
        raise InputError(problem, path=path)
    try:
        mount = mount_of(content.tree, content.odometry.frame, content.optical_frame)
    except ValueError as error:
        raise InputError(f"{error}; give camera and mount with --camera FILE", path=path, field="tf_static") from None
    rectified = _IN_RECTIFIED in topic.name
    return camera_of(info.content, mount, rectified=rectified, name=name, source=f"{path} {info.topic}")


def _distinct(times: list[int], path: Path, topic: str) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return sorted times as an array. Raises InputError when two are the same."""
    found = np.array(times, dtype=np.int64)
    same = np.flatnonzero(np.diff(found) == 0)
    if len(same):
        raise InputError(f"expected stamps that differ, found {found[same[0]]} ns twice", path=path, field=topic)
    return found
