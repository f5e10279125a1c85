"""Read a ROS bag as a log: one pass collects times and poses, images are fetched later, one by one."""

from __future__ import annotations

import weakref
from base64 import b64decode
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera, Mount
from localiser.documents import Document, plain_name, validate
from localiser.errors import InputError, InputNote, warn
from localiser.filter import Start
from localiser.geometry import Trajectory
from localiser.landmarks import LandmarkMap
from localiser.storage.bags.bag import (
    CAMERA_TOPIC,
    DECISIONS_TOPIC,
    IMAGE_KINDS,
    LOG_TOPIC,
    MAP_TOPIC,
    METADATA_FILE,
    STATE_TOPIC,
    SUFFIXES,
    TIMES,
    Bag,
    Message,
    RosType,
    Topic,
    choice_text,
    choose,
    files_by_number,
    speaks_of_depth,
)
from localiser.storage.bags.camera_finder import CameraFinder
from localiser.storage.bags.messages import image_file, shows_light
from localiser.storage.bags.transforms import LostPoseError, floor_pose, plain_frame, stamp_of
from localiser.storage.bags.write import FORMAT, Decisions, Label, document_of, with_label, with_sigma
from localiser.storage.cameras import camera_from_document, read_camera
from localiser.storage.folder import start_from_file
from localiser.storage.images import ImageEvent, check_size, check_whole, image_event
from localiser.storage.log import Log, ReadOptions, require_overlap
from localiser.storage.maps import map_from_document

Made = TypeVar("Made")
MOST_LOST = 0.1  # of the poses


class BagReader:
    """Reads ROS bags."""

    format, looks_like, options = "bag", "a ROS bag", ("topics", "camera")

    def recognises(self, path: Path) -> bool:
        """Whether `path` is a bag's file, or the folder of a ROS 2 bag, also of one whose recorder was killed."""
        return path.suffix in SUFFIXES or (
            path.is_dir() and bool((path / METADATA_FILE).exists() or files_by_number(path))
        )

    def read(self, path: Path, options: ReadOptions) -> Log:
        """Return the log; the bag is read once from end to end. Raises InputError."""
        given = read_camera(options.camera) if options.camera else None
        with Bag(path) as bag:
            asked = dict(options.topics)
            if (times := asked.pop(TIMES, "stamps")) not in ("stamps", "recorded"):
                raise InputError(f"expected {TIMES}=recorded, found {times!r}", field="--topic")
            roles = choose(path, bag.topics, asked, _stated_topics(bag), lambda topic: _is_picture(bag, topic))
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
                    rectified=next((kind == "image_rect" for kind in IMAGE_KINDS if kind in asked), None),
                ),
                is_recorded=times == "recorded",
                truth_frame="" if "groundtruth" in roles.values() else plain_frame(asked.get("groundtruth", "")),
            )
            for message in bag.messages(roles):
                content.take(message)
            if bag.broken:
                warn(f"cannot be read to its end: {bag.broken}; the log ends there", path=path)
            log = _log(content, image, given)
            if content.label is None:
                floor = content.finder.floor if given is None else "the floor, by the camera file"
                warn(f"{choice_text(roles, bag.topics)}; heights above {floor}", path=path, kind=InputNote)
        return log


def _is_picture(bag: Bag, topic: Topic) -> bool:
    """Whether the first image of a topic shows light; whole numbers of 16 bits do where its name speaks of no depth."""
    first = next(bag.messages([topic]), None)
    return first is None or shows_light(first.content, is_deep=speaks_of_depth(topic.name))


def _stated_topics(bag: Bag) -> Mapping[str, str]:
    """Return which topics a live run listened to, by what they are for, if the bag is a recording of one."""
    stated = [topic for topic in bag.topics if (topic.name, topic.msgtype) == (LOG_TOPIC, RosType.TEXT)]
    message = next(bag.messages(stated), None)
    return {} if message is None else validate(_document(bag.path, message), Label).topics or {}


def _document(path: Path, message: Message) -> Document:
    try:
        return document_of(message.content.data, f"{path} {message.topic}")
    except ValueError as error:
        raise InputError(str(error), path=path, field=f"{message.topic} at {message.t_ns} ns") from None


@dataclass(slots=True, eq=False)
class _Poses:
    """Poses of one topic, or of one frame. rows: (t_ns, x, z, heading), nan where the robot was lost."""

    rows: list[tuple[int, float, float, float]] = field(default_factory=list)
    topic: str = ""

    def take(self, stamp_ns: int, topic: str, content: Any) -> None:
        """Add the floor part of a message of poses. Raises ValueError."""
        try:
            pose = floor_pose(content)
        except LostPoseError:
            pose = (np.nan, np.nan, np.nan)
        self.rows.append((stamp_ns, *pose))
        self.topic = topic

    def trajectory(self, path: Path) -> Trajectory:
        """Return the poses in the order of their stamps. Raises InputError when too many are lost."""
        rows = np.array(self.rows)
        known = np.isfinite(rows[:, 1:]).all(axis=1)
        if lost := int((~known).sum()):
            what = f"{lost} of {len(rows)} poses of {self.topic} that are null or nan"
            if lost > MOST_LOST * len(rows):
                raise InputError(f"expected at most a tenth of the poses to be null or nan, found {what}", path=path)
            warn(f"left out {what}", path=path)
        times = np.array([row[0] for row in self.rows], dtype=np.int64)[known]
        order = _first_of_each(times, path, self.topic)
        return Trajectory(times[order], rows[known][order, 1:])


def _first_of_each(times: NDArray[np.int64], path: Path, topic: str) -> NDArray[np.int64]:
    """Return the order of times; of those that are the same the first is kept, with a warning.

    Raises InputError where headers have no stamps.
    """
    if len(times) > 1 and not times.any():
        problem = f"expected stamps in the headers, found none in {len(times)} messages; take the times of recording "
        raise InputError(f"{problem}with --topic {TIMES}=recorded", path=path, field=topic)
    order = np.argsort(times, kind="stable")
    again = np.diff(times[order], prepend=-1) == 0
    if again.any():
        what = f"{again.sum()} of {len(times)} messages of {topic} with a stamp that was there already"
        warn(f"left out {what}, such as {times[order][again][0] / 1e9:.9f} s", path=path)
    return np.asarray(order[~again])


@dataclass(slots=True, eq=False)
class _Content:
    """What one pass over a bag collects. roles: what each topic is for, by its name and the type of its messages.

    is_recorded: whether times are those of recording. truth_frame: a frame of /tf whose transforms are the truth.
    """

    path: Path
    roles: dict[tuple[str, str], str]
    finder: CameraFinder
    is_recorded: bool = False
    truth_frame: str = ""
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
        if self.is_recorded:
            first = next(iter(getattr(content, "transforms", ())), content)
            offset_ns = message.t_ns - stamp_of(first) if hasattr(first, "header") else 0
        if role == "image":
            self.finder.take_image(content)
            stamp_ns = message.stamp_ns + offset_ns
            self.images.append(ImagePlace(stamp_ns, message.place, len(self.images), offset_ns))
        elif role == "odometry":
            self.odometry.take(message.stamp_ns + offset_ns, message.topic, content)
            self.finder.take_odometry(content)
        elif role == "groundtruth":
            self.groundtruth.take(message.stamp_ns + offset_ns, message.topic, content)
        elif role == "camera_info":
            self.finder.take_info(content)
        elif role == "transforms":
            self.finder.take_transforms(content)
        elif role == "imu":
            self.finder.take_inertial(content, offset_ns)
        elif role == "moving_transforms":
            self.finder.take_moving(content, offset_ns)
            for stamped in content.transforms if self.truth_frame else ():
                if plain_frame(stamped.child_frame_id) == self.truth_frame:
                    self.groundtruth.take(stamp_of(stamped) + offset_ns, self.truth_frame, stamped)
        else:
            self._take_text(role, message)

    def _take_text(self, role: str, message: Message) -> None:
        if role == DECISIONS_TOPIC:
            self.decisions.take(message.content.data)
        elif role == STATE_TOPIC:
            self.resumed = b64decode(message.content.data, validate=True)
        elif role == LOG_TOPIC:
            self.label = validate(_document(self.path, message), Label)
        elif role == MAP_TOPIC:
            self.landmark_map = map_from_document(_document(self.path, message))
        elif role == CAMERA_TOPIC and self.finder.camera is None:
            self.finder.take_camera(camera_from_document(_document(self.path, message)))


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
    stamps = np.array([place.stamp_ns for place in content.images], dtype=np.int64)
    places = [content.images[number] for number in _first_of_each(stamps, path, topic.name)]
    if content.truth_frame and not content.groundtruth.rows:
        problem = f"expected a topic of poses, or a frame of /tf, found no {content.truth_frame!r}"
        raise InputError(problem, path=path, field="groundtruth")
    odometry = content.odometry.trajectory(path)
    label = content.label or Label(format=FORMAT, name=plain_name(path.resolve().stem))
    mounts: Sequence[Mount | None] = [None] * len(places)
    if given is None and not content.finder.is_given:
        mounts = _made(content, lambda: content.finder.mounts([place.stamp_ns for place in places]))
        mounts = with_sigma(mounts, label)
    camera = given or content.finder.camera or _made(content, content.finder.made)
    camera = camera if given else with_label(camera, label)
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


@dataclass(frozen=True, slots=True)
class ImagePlace:
    """Where an image stands in a bag: its `Message.place`. stamp_ns: when it was taken.

    order: how many images of its topic were recorded before it. offset_ns: what was added to the stamp in its message.
    """

    stamp_ns: int
    place: tuple[int, int, int]
    order: int
    offset_ns: int = 0


class Playback:
    """Fetches images of one topic; in the order of recording each is read once, in any other the bag is searched."""

    def __init__(self, path: Path, topic: Topic, size: tuple[int, int]) -> None:
        """Prepare to read; the bag is opened when the first image is asked for. size: (width, height) expected."""
        self._path, self._topic, self._size = path, topic, size
        self._bag: Bag | None = None
        self._messages: Iterator[Message] = iter(())
        self._next = -1
        self._last: tuple[int, bytes] | None = None

    def event(self, place: ImagePlace, *, by_wheels: bool = True, mount: Mount | None = None) -> ImageEvent:
        """Return the image as an event of a log; by_wheels, mount: see there."""
        field = f"{self._topic.name} at {place.stamp_ns} ns"

        def file() -> bytes:
            """Return the image as a JPEG or PNG file that is whole and of the right size."""
            if self._last is None or self._last[0] != place.order:
                try:
                    data = image_file(self._fetch(place).content)
                except ValueError as error:
                    raise InputError(str(error), path=self._path, field=field) from None
                check_whole(data, self._size, path=self._path, field=field)
                self._last = (place.order, data)
            return self._last[1]

        name = f"{self._topic.name}/{place.order:06d}"
        return image_event(
            place.stamp_ns, name, file, self._size, path=self._path, field=field, by_wheels=by_wheels, mount=mount
        )

    def _fetch(self, place: ImagePlace) -> Message:
        if self._bag is None:
            self._bag = Bag(self._path)
            weakref.finalize(self, self._bag.close)
        if place.order != self._next:
            self._messages = self._bag.messages([self._topic], place.place)
        message = next(self._messages, None)
        if message is None or message.stamp_ns + place.offset_ns != place.stamp_ns:
            raise InputError("expected the image that was here when the bag was opened", path=self._path)
        self._next = place.order + 1
        return message
