"""Read a ROS bag as a log: one pass collects times and poses, images are fetched later, one by one."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from localiser.camera import Camera, Mount
from localiser.documents import Document, plain_name, validate
from localiser.errors import InputError
from localiser.filter import Start
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap
from localiser.storage.bags.bag import METADATA_FILE, SUFFIXES, TEXT, Bag, Message, Topic
from localiser.storage.bags.camera_finder import CameraFinder
from localiser.storage.bags.decisions import Decisions
from localiser.storage.bags.frames import floor_pose
from localiser.storage.bags.label import FORMAT, Label, document_of, labelled, with_sigma
from localiser.storage.bags.playback import ImagePlace, Playback
from localiser.storage.bags.topics import (
    CAMERA_TOPIC,
    DECISIONS_TOPIC,
    IMAGE_KINDS,
    LOG_TOPIC,
    MAP_TOPIC,
    STATE_TOPIC,
    choose,
)
from localiser.storage.cameras import camera_from_document, read_camera
from localiser.storage.folder import start_from_file
from localiser.storage.images import check_size
from localiser.storage.log import Log, ReadOptions, require_overlap
from localiser.storage.maps import map_from_document

Made = TypeVar("Made")


class BagReader:
    """Reads ROS bags."""

    format, looks_like, options = "bag", "a ROS bag", ("topics", "camera")

    def recognises(self, path: Path) -> bool:
        """Whether `path` is a bag's file, or the folder of a ROS 2 bag."""
        return path.suffix in SUFFIXES or (path / METADATA_FILE).exists()

    def read(self, path: Path, options: ReadOptions) -> Log:
        """Return the log; the bag is read once from end to end. Raises InputError."""
        given = read_camera(options.camera) if options.camera else None
        with Bag(path) as bag:
            roles = choose(path, bag.topics, options.topics, _stated_topics(bag))
            image = next(topic for topic, role in roles.items() if role == "image")
            is_live = DECISIONS_TOPIC in roles.values()
            infos = [topic.name for topic, role in roles.items() if role == "camera_info"]
            content = _Content(
                path,
                {(topic.name, topic.msgtype): role for topic, role in roles.items()},
                CameraFinder(
                    None,
                    image.name,
                    " ".join([str(path), *infos]),
                    at_once=is_live,
                    rectified=next((kind == "image_rect" for kind in IMAGE_KINDS if kind in options.topics), None),
                ),
            )
            fault = _taken(content, bag, roles, up_to_fault=is_live and options.up_to_fault)
        return replace(_log(content, image, given), fault=fault)


def _taken(content: _Content, bag: Bag, topics: Collection[Topic], *, up_to_fault: bool) -> InputError | None:
    """Take all messages; up_to_fault: or those before the first one that is wrong, which is returned."""
    try:
        for message in bag.messages(topics):
            content.take(message)
    except InputError as error:
        if not (up_to_fault and content.decisions.images):
            raise
        return error
    return None


def _stated_topics(bag: Bag) -> Mapping[str, str]:
    """Return which topics a live run listened to, by what they are for, if the bag is a recording of one."""
    stated = [topic for topic in bag.topics if (topic.name, topic.msgtype) == (LOG_TOPIC, TEXT)]
    message = next(bag.messages(stated), None)
    return {} if message is None else _label(bag.path, message).topics or {}


def _label(path: Path, message: Message) -> Label:
    """Return name and settings of a log. Raises InputError."""
    return validate(_document(path, message), Label)


def _document(path: Path, message: Message) -> Document:
    try:
        return document_of(message.content.data, f"{path} {message.topic}")
    except ValueError as error:
        raise InputError(str(error), path=path, field=f"{message.topic} at {message.t_ns} ns") from None


@dataclass(slots=True, eq=False)
class _Poses:
    """Poses of one odometry topic. rows: (t_ns, x, z, heading)."""

    rows: list[tuple[int, float, float, float]] = field(default_factory=list)
    topic: str = ""

    def take(self, message: Message, offset_ns: int) -> None:
        """Add the floor part of a nav_msgs/Odometry. Raises ValueError."""
        self.rows.append((message.stamp_ns + offset_ns, *floor_pose(message.content)))
        self.topic = message.topic

    def trajectory(self, path: Path) -> Trajectory:
        """Return the poses in the order of their stamps. Raises InputError when two have the same."""
        rows = sorted(self.rows)
        times = _distinct([row[0] for row in rows], path, self.topic)
        return Trajectory(times, np.array([row[1:] for row in rows]))


@dataclass(slots=True, eq=False)
class _Content:
    """What one pass over a bag collects. roles: what each topic is for, by its name and the type of its messages."""

    path: Path
    roles: dict[tuple[str, str], str]
    finder: CameraFinder
    images: list[ImagePlace] = field(default_factory=list)
    odometry: _Poses = field(default_factory=_Poses)
    groundtruth: _Poses = field(default_factory=_Poses)
    label: Label | None = None
    landmark_map: LandmarkMap | None = None
    decisions: Decisions = field(default_factory=Decisions)
    resumed: bytes = b""

    def take(self, message: Message) -> None:
        """Keep what a message says. Raises InputError."""
        try:
            self._take(self.roles[message.topic, message.msgtype], message)
        except ValueError as error:
            field = f"{message.topic} at {message.t_ns} ns"
            raise InputError(str(error), path=self.path, field=field) from None

    def _take(self, role: str, message: Message) -> None:
        content, offset_ns = message.content, self.decisions.offset_ns
        if role == "image":
            self._take_image(message, offset_ns)
        elif role == "odometry":
            self.odometry.take(message, offset_ns)
            self.finder.take_odometry(content)
        elif role == "groundtruth":
            self.groundtruth.take(message, offset_ns)
        elif role == "camera_info":
            self.finder.take_info(content)
        elif role == "transforms":
            self.finder.take_transforms(content)
        elif role == "imu":
            self.finder.take_inertial(content, offset_ns)
        elif role == "moving_transforms":
            self.finder.take_moving(content, offset_ns)
        elif role == DECISIONS_TOPIC:
            self.decisions.take(content.data)
        elif role == STATE_TOPIC:
            self.resumed = b64decode(content.data, validate=True)
        elif role == LOG_TOPIC:
            self.label = _label(self.path, message)
        elif role == MAP_TOPIC:
            self.landmark_map = map_from_document(_document(self.path, message))
        elif role == CAMERA_TOPIC and self.finder.camera is None:
            self.finder.take_camera(camera_from_document(_document(self.path, message)))

    def _take_image(self, message: Message, offset_ns: int) -> None:
        self.finder.take_image(message.content)
        last = self.images[-1] if self.images else None
        later = last.later + 1 if last is not None and last.recorded_ns == message.t_ns else 0
        self.images.append(ImagePlace(message.stamp_ns + offset_ns, message.t_ns, len(self.images), later, offset_ns))


# -- from what was collected to a log ---------------------------------------------------------------------------------


def _log(content: _Content, topic: Topic, given: Camera | None) -> Log:
    """Return the log that a bag holds. topic: of the images. given: the camera in place of what the bag says of it."""
    path, decisions = content.path, content.decisions
    if decisions.any:  # the recording of a live run: what that did not use is left out
        rows, unused = content.odometry.rows, decisions.unused_odometry
        content.odometry.rows = [row for k, row in enumerate(rows) if k not in unused]
        content.images = [place for place in content.images if place.order in decisions.images]
    if not content.images or not content.odometry.rows:
        raise InputError("expected images and odometry, found a bag that is cut off", path=path)
    places = sorted(content.images, key=lambda place: place.stamp_ns)
    _distinct([place.stamp_ns for place in places], path, topic.name)
    odometry = content.odometry.trajectory(path)
    label = content.label or Label(format=FORMAT, name=plain_name(path.resolve().stem))
    mounts: Sequence[Mount | None] = [None] * len(places)
    if given is None and not content.finder.is_given:
        mounts = _made(content, lambda: content.finder.mounts([place.stamp_ns for place in places]))
        mounts = with_sigma(mounts, label)
    camera = given or content.finder.camera or _made(content, content.finder.made)
    camera = camera if given else labelled(camera, label)
    first_ns = min(int(odometry.t_ns[0]), places[0].stamp_ns)
    starts = decisions.starts or [start_from_file(label.start, first_ns) if label.start else None]
    size = (camera.width, camera.height)
    check_size(path, content.finder.size or size, size, topic.name)
    playback = Playback(path, topic, size)
    log = Log(
        name=label.name,
        path=path,
        camera=camera,
        odometry=odometry,
        frames=[
            playback.event(place, by_wheels=place.order not in decisions.blind, mount=mount)
            for place, mount in zip(places, mounts, strict=True)
        ],
        landmark_map=content.landmark_map,
        start=starts[0] if isinstance(starts[0], Start) else None,
        restarts=[start for start in starts[1:] if start is not None],
        resumed=content.resumed,
        groundtruth=content.groundtruth.trajectory(path) if content.groundtruth.rows else None,
        settings={f"motion.{name}": value for name, value in (label.motion or {}).items()} | (label.settings or {}),
    )
    return require_overlap(log)


def _made(content: _Content, make: Callable[[], Made]) -> Made:
    """Return what is made of camera_info and transforms. Raises InputError."""
    try:
        return make()
    except ValueError as error:
        problem = f"{error}; give camera and mount with --camera FILE"
        raise InputError(problem, path=content.path, field="camera") from None


def _distinct(times: list[int], path: Path, topic: str) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return sorted times as an array. Raises InputError when two are the same."""
    found = np.array(times, dtype=np.int64)
    same = np.flatnonzero(np.diff(found) == 0)
    if len(same):
        raise InputError(f"expected stamps that differ, found {found[same[0]]} ns twice", path=path, field=topic)
    return found
