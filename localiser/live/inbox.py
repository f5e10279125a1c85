"""What comes in: topics and their types, a bounded queue of messages, reading them, and a camera by OpenCV."""

from __future__ import annotations

import heapq
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from threading import Condition, Event, Thread
from typing import Any

import cv2
import numpy as np

from localiser.documents import nearest, text_of
from localiser.errors import InputError
from localiser.ros import Topic, topic_in
from localiser.storage import encode_image, open_stream
from localiser.storage.bags import RosType, typestore

_ROLES = {
    "image": ("/camera/image_raw/compressed", ""),
    "camera_info": ("/camera/camera_info", RosType.CAMERA_INFO),
    "odometry": ("/odom", RosType.ODOMETRY),
    "groundtruth": ("/ground_truth/odom", RosType.ODOMETRY),
    "transforms": ("/tf_static", RosType.TRANSFORMS),
    "moving_transforms": ("/tf", RosType.TRANSFORMS),
    "initialpose": ("/initialpose", RosType.POSE),
    "clock": ("/clock", RosType.CLOCK),
}
TOPICS = {role: topic for role, (topic, _) in _ROLES.items()}
"""What is listened to by what it is for, unless another topic is named; to the clock only where it is asked for."""

MOST_MESSAGE_BYTES = 64 * 2**20
MOST_TRANSFORMS_BYTES = 2**18  # 2000 transforms: what is read in a moment
MOST_IMAGES = 32
MOST_OTHERS = 1024
"""Seconds of images, and of odometry: what a pause of the program may take, and no more than is read within 0.3 s."""

MOST_BYTES = 128 * 2**20
"""Of all that waits, whatever its sizes."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A message as it came. role: what its topic is for. content: its bytes, CDR as ROS 2 has it.

    at_ns: when it came, by this machine's monotonic clock. wall_ns: the same by the calendar. source: who sent it, b""
    where the network does not tell. reply: answers it, where it is a request of a service.
    """

    role: str
    topic: str
    content: bytes
    at_ns: int = field(default_factory=time.monotonic_ns)
    wall_ns: int = field(default_factory=time.time_ns)
    source: bytes = b""
    reply: Callable[[bytes], None] | None = None


class Inbox:
    """A queue from the threads of the sources to the loop; where it is full, the oldest of a role is dropped."""

    def __init__(
        self, most_images: int = MOST_IMAGES, most_others: int = MOST_OTHERS, most_bytes: int = MOST_BYTES
    ) -> None:
        """Start empty."""
        self._most, self._most_others, self._most_bytes = {"image": most_images}, most_others, most_bytes
        self._queues: dict[str, deque[tuple[int, Arrival]]] = {}
        self._bytes: Counter[str] = Counter()
        self._order = count()
        self._changed = Condition()
        self.dropped: Counter[str] = Counter()

    def put(self, arrival: Arrival) -> None:
        """Take a message in; never waits."""
        role = arrival.role
        with self._changed:
            queue = self._queues.setdefault(role, deque())
            if len(queue) >= self._most.get(role, self._most_others):
                self._drop(role)
            queue.append((next(self._order), arrival))
            self._bytes[role] += len(arrival.content)
            while self._bytes.total() > self._most_bytes:  # of what needs the most memory
                self._drop(max(self._bytes, key=self._bytes.__getitem__))
            self._changed.notify()

    def take(self, wait_s: float) -> list[Arrival]:
        """Return all that has arrived, in that order; waits for something to arrive, but not longer than `wait_s`."""
        with self._changed:
            self._changed.wait_for(lambda: any(self._queues.values()), wait_s)
            queues, self._queues = self._queues, {}
            self._bytes.clear()
        return [arrival for _, arrival in heapq.merge(*queues.values())]

    def _drop(self, role: str) -> None:
        _, oldest = self._queues[role].popleft()
        self._bytes[role] -= len(oldest.content)
        self.dropped[role] += 1


def type_of(role: str, topic: str) -> str:
    """Return the type of the messages on a topic; compressed images are known by its name, as ROS has it."""
    if role == "image":
        return RosType.COMPRESSED if topic.rsplit("/", 1)[-1].startswith("compressed") else RosType.IMAGE
    return _ROLES[role][1]


def topic_for(role: str, name: str) -> Topic:
    """Return the topic of a role with its quality of service: sensor data may be lost, fixed transforms are latched."""
    if role == "transforms":
        return Topic(name, type_of(role, name), latched=True, depth=100)
    if role == "initialpose":
        return Topic(name, type_of(role, name))
    return Topic(name, type_of(role, name), reliable=False, depth=5 if role == "image" else 100)


def message_of(arrival: Arrival) -> Any:
    """Return the message that arrived. Raises ValueError when it is not one of its type."""
    msgtype = type_of(arrival.role, arrival.topic)
    most = MOST_TRANSFORMS_BYTES if msgtype == RosType.TRANSFORMS else MOST_MESSAGE_BYTES
    if len(arrival.content) > most:
        raise ValueError(f"expected at most {most} bytes, found {len(arrival.content)}")
    try:
        message: Any = typestore(ros1=False).deserialize_cdr(arrival.content, msgtype)
        stamp = message.header.stamp if arrival.role not in ("transforms", "moving_transforms", "clock") else None
        if stamp is not None and not (stamp.sec >= 0 and 0 <= stamp.nanosec < 10**9):
            raise ValueError(f"a stamp of {stamp.sec} s and {stamp.nanosec} ns")
    except Exception as error:  # whatever bytes that are no message make of a decoder
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise ValueError(f"expected a {msgtype}, found {len(arrival.content)} bytes that are none ({reason})") from None
    return message


def input_topics(asked: Mapping[str, str], namespace: str = "") -> dict[str, str]:
    """Return the topic of every role. asked: in place of those in TOPICS.

    namespace: of all topics but those that are asked for with a leading slash, and the clock: one simulator tells the
    time of all robots, and every node of ROS listens to /clock.

    Raises InputError for an unknown role, and where a topic would have two roles: each of its messages would be taken,
    and recorded, twice.
    """
    for role in asked:
        if role not in TOPICS:
            raise InputError(f"unknown kind of topic; {nearest(role, list(TOPICS))}", field="live.topics")
    names = {role: topic if role == "clock" else topic.removeprefix("/") for role, topic in TOPICS.items()}
    topics = {role: topic_in(namespace, name) for role, name in (names | dict(asked)).items()}
    _check_apart([(role, "live.topics", name) for role, name in topics.items()])
    return topics


def check_outputs(topics: Mapping[str, str], outputs: Mapping[str, Topic]) -> None:
    """Check that nothing goes out on a topic that comes in, nor two things on one topic. Raises InputError.

    topics: of what comes in, by role. All transforms that move are on one topic, those of the robot and our own.
    """
    shared = outputs["tf"].name if "tf" in outputs else None
    incoming = {role: name for role, name in topics.items() if (role, name) != ("moving_transforms", shared)}
    named = [(f"what comes in as {role}", "live.topics", name) for role, name in incoming.items()]
    _check_apart(named + [(f"what goes out as {kind}", "live.publish", one.name) for kind, one in outputs.items()])


def _check_apart(named: list[tuple[str, str, str]]) -> None:
    """Raise InputError where two have one name. named: what, by which option, and the name."""
    found: dict[str, str] = {}
    for what, option, name in named:
        topic = name.strip("/")
        if topic in found:
            raise InputError(
                f"expected a topic of its own for each kind, found {name} for {found[topic]} and for {what}",
                field=option,
            )
        found[topic] = what


# -- a camera ---------------------------------------------------------------------------------------------------------

JPEG_QUALITY = 95  # the filter sees what is recorded
_RETRY_S = 1.0


class CameraSource:
    """Hands every frame with its time over as a JPEG file, in a thread of its own; one that goes away is tried again.

    A frame's time is when it came out of the camera, by the calendar. A file is played at its own rate. Frames that are
    JPEG files already are not decoded here, nor looked at.
    """

    def __init__(self, address: str, take: Callable[[int, bytes], None]) -> None:
        """Open the camera, and begin to read. take: gets the time (ns) and the file. Raises InputError."""
        self._address, self._take = address, take
        self._is_file = Path(address).is_file()
        self._stop = Event()
        self._capture = self._open()
        if self._capture is None:
            raise InputError("expected a camera that can be opened", path=address, field="--image")
        self._thread = Thread(target=self._read, name="camera", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop reading."""
        self._stop.set()
        self._thread.join(2.0)

    def _read(self) -> None:
        begin_ns = time.time_ns()
        while not self._stop.is_set():
            capture, is_packed = self._capture or (None, False)
            image = None if capture is None else capture.read()[1]
            if capture is not None and image is not None and image.dtype == np.uint8:
                t_ns = time.time_ns()
                if self._is_file:
                    t_ns = begin_ns + round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
                    self._stop.wait((t_ns - time.time_ns()) / 1e9)
                self._take(t_ns, image.tobytes() if is_packed else encode_image(image, ".jpg", JPEG_QUALITY))
            elif self._is_file:
                return
            else:
                self._stop.wait(_RETRY_S)
                with suppress(InputError):  # another stream than at the begin, which is not read
                    self._capture = self._open()

    def _open(self) -> tuple[Any, bool] | None:
        """Return the open camera, and whether its frames come as files; or None. Raises InputError."""
        if not (self._address.isascii() and self._address.isdigit()):
            return open_stream(text_of(self._address))
        capture = cv2.VideoCapture(int(self._address))
        if not capture.isOpened():
            return None
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # where the driver knows it: the newest frame, not the oldest
        return capture, False
