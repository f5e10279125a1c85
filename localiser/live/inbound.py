"""Read and check messages that arrived. An error in a message is reported, and only this message is lost."""

from __future__ import annotations

from typing import Any

import numpy as np

from localiser.camera import Camera
from localiser.errors import InputError
from localiser.live.sources import Arrival
from localiser.live.transports import Topic
from localiser.storage.bags import (
    CAMERA_INFO,
    COMPRESSED,
    IMAGE,
    ODOMETRY,
    POSE,
    TRANSFORMS,
    FrameTree,
    camera_of,
    mount_of,
    plain_frame,
    stated_size,
    typestore,
)

TOPICS = {
    "image": "/camera/image_raw/compressed",
    "camera_info": "/camera/camera_info",
    "odometry": "/odom",
    "groundtruth": "/ground_truth/odom",
    "transforms": "/tf_static",
    "initialpose": "/initialpose",
}
"""What is listened to by what it is for, unless another topic is named."""

_TYPES = {
    "camera_info": CAMERA_INFO,
    "odometry": ODOMETRY,
    "groundtruth": ODOMETRY,
    "transforms": TRANSFORMS,
    "initialpose": POSE,
}
MOST_BYTES = 64 * 2**20


def type_of(role: str, topic: str) -> str:
    """Return the type of the messages on a topic; compressed images are told by its name, as ROS has it."""
    if role == "image":
        return COMPRESSED if topic.rsplit("/", 1)[-1].startswith("compressed") else IMAGE
    return _TYPES[role]


def topic_for(role: str, name: str) -> Topic:
    """Return the topic of a role with its quality of service: sensor data may be lost, fixed transforms are latched."""
    if role == "transforms":
        return Topic(name, type_of(role, name), latched=True, depth=100)
    if role == "initialpose":
        return Topic(name, type_of(role, name))
    return Topic(name, type_of(role, name), reliable=False, depth=5)


def message_of(arrival: Arrival) -> Any:
    """Return the message that arrived. Raises ValueError when it is not one of its type."""
    if len(arrival.content) > MOST_BYTES:
        raise ValueError(f"expected at most {MOST_BYTES} bytes, found {len(arrival.content)}")
    msgtype = type_of(arrival.role, arrival.topic)
    try:
        message = typestore(ros1=False).deserialize_cdr(arrival.content, msgtype)
        if arrival.role != "transforms":
            _check_header(message)
    except Exception as error:  # whatever bytes that are no message make of a decoder
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise ValueError(f"expected a {msgtype}, found {len(arrival.content)} bytes that are none ({reason})") from None
    return message


def _check_header(message: Any) -> None:
    stamp = message.header.stamp
    if not (stamp.sec >= 0 and 0 <= stamp.nanosec < 10**9):
        raise ValueError(f"a stamp of {stamp.sec} s and {stamp.nanosec} ns")


class CameraFinder:
    """Puts the camera together from what a robot says: camera_info, fixed transforms, and whose frames they are."""

    def __init__(self, given: Camera | None, image_topic: str) -> None:
        """Begin. given: the camera from a file, which comes before anything that a robot says."""
        self.camera = given
        self._rectified = "image_rect" in image_topic
        self._info: Any = None
        self._tree = FrameTree()
        self._optical = self._base = ""
        self.problem = "no camera_info"

    def take_info(self, info: Any) -> None:
        """Take a CameraInfo. Raises ValueError when the intrinsics change."""
        if self._info is not None and not np.array_equal(self._info.k, info.k):
            raise ValueError("expected one camera, found intrinsics that change; those found first are used")
        self._info = info
        self._find()

    def take_transforms(self, message: Any) -> None:
        """Take a TFMessage. Raises ValueError."""
        self._tree.add_all(message.transforms)
        self._find()

    def take_image(self, image: Any) -> None:
        """Take an image. Raises ValueError when it has not the camera's size, or none."""
        size = stated_size(image)
        if not self._optical:
            self._optical = plain_frame(image.header.frame_id)
            self._find()
        if self.camera is not None and size != (self.camera.width, self.camera.height):
            expected = f"{self.camera.width}×{self.camera.height}"
            raise ValueError(f"expected images of {expected} pixels, as the camera says, found {size[0]}×{size[1]}")

    def take_odometry(self, odometry: Any) -> None:
        """Take an Odometry."""
        if not self._base:
            self._base = plain_frame(odometry.child_frame_id)
            self._find()

    def _find(self) -> None:
        if self.camera is not None or self._info is None:
            return
        try:
            mount = mount_of(self._tree, self._base, self._optical)
            self.camera = camera_of(self._info, mount, rectified=self._rectified, name="", source=TOPICS["camera_info"])
        except (ValueError, InputError) as error:
            self.problem = str(error)
