"""Read and check messages that arrived. An error in a message is reported, and only this message is lost."""

from __future__ import annotations

from typing import Any

from localiser.live.sources import Arrival
from localiser.live.transports import Topic
from localiser.storage.bags import (
    CAMERA_INFO,
    CLOCK,
    COMPRESSED,
    IMAGE,
    ODOMETRY,
    POSE,
    TRANSFORMS,
    typestore,
)

TOPICS = {
    "image": "/camera/image_raw/compressed",
    "camera_info": "/camera/camera_info",
    "odometry": "/odom",
    "groundtruth": "/ground_truth/odom",
    "transforms": "/tf_static",
    "moving_transforms": "/tf",
    "initialpose": "/initialpose",
    "clock": "/clock",
}
"""What is listened to by what it is for, unless another topic is named; to the clock only where it is asked for."""

_TYPES = {
    "camera_info": CAMERA_INFO,
    "odometry": ODOMETRY,
    "groundtruth": ODOMETRY,
    "transforms": TRANSFORMS,
    "moving_transforms": TRANSFORMS,
    "initialpose": POSE,
    "clock": CLOCK,
}
MOST_BYTES = 64 * 2**20
MOST_TRANSFORMS_BYTES = 2**18  # 2000 transforms: what is read in a moment


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
    return Topic(name, type_of(role, name), reliable=False, depth=5 if role == "image" else 100)


def message_of(arrival: Arrival) -> Any:
    """Return the message that arrived. Raises ValueError when it is not one of its type."""
    msgtype = type_of(arrival.role, arrival.topic)
    most = MOST_TRANSFORMS_BYTES if msgtype == TRANSFORMS else MOST_BYTES
    if len(arrival.content) > most:
        raise ValueError(f"expected at most {most} bytes, found {len(arrival.content)}")
    try:
        message = typestore(ros1=False).deserialize_cdr(arrival.content, msgtype)
        if arrival.role not in ("transforms", "moving_transforms", "clock"):
            _check_header(message)
    except Exception as error:  # whatever bytes that are no message make of a decoder
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise ValueError(f"expected a {msgtype}, found {len(arrival.content)} bytes that are none ({reason})") from None
    return message


def _check_header(message: Any) -> None:
    stamp = message.header.stamp
    if not (stamp.sec >= 0 and 0 <= stamp.nanosec < 10**9):
        raise ValueError(f"a stamp of {stamp.sec} s and {stamp.nanosec} ns")
