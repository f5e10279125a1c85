"""Choose which topic of a bag is what: by type, by names that are a custom, or by asking where several fit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from localiser.documents import nearest
from localiser.errors import InputError
from localiser.storage.bags.bag import CAMERA_INFO, COMPRESSED, IMAGE, IMU, ODOMETRY, TEXT, TRANSFORMS, Topic

LOG_TOPIC, MAP_TOPIC = "/localiser/log", "/localiser/map"
CAMERA_TOPIC, DECISIONS_TOPIC = "/localiser/camera", "/localiser/decisions"
STATE_TOPIC, IMU_TOPIC = "/localiser/state", "/localiser/imu"
OUR_NAMES = "/localiser/"
"""What the names of this program's own topics begin with: no source of images, unless asked for."""
LABEL_TOPICS = (LOG_TOPIC, MAP_TOPIC, CAMERA_TOPIC, DECISIONS_TOPIC, STATE_TOPIC)
TYPES = {
    "image": (IMAGE, COMPRESSED),
    "camera_info": (CAMERA_INFO,),
    "odometry": (ODOMETRY,),
    "groundtruth": (ODOMETRY,),
    "imu": (IMU,),
}
IMAGE_KINDS = ("image_raw", "image_rect")
"""Images by what was done to them: their lens distortion is as the camera took them, or undone."""
_TRUTH = re.compile(r"ground_?truth", re.IGNORECASE)
_MOST_LISTED = 12


def choose(
    path: Path, topics: Sequence[Topic], asked: Mapping[str, str], stated: Mapping[str, str]
) -> dict[Topic, str]:
    """Return the topics of a log and what each is for; one that this program adds to a bag stands for itself.

    asked: names by what they are for, which come before any guess; of images also by IMAGE_KINDS. stated: the same,
    as the bag says.

    An odometry whose name says ground truth is the truth. Of several camera_info the one beside the image is taken, as
    ROS names them. An inertial sensor is taken only where it was asked for. Raises InputError that lists the choices
    when several fit or none does.
    """
    asked = {"image" if role in IMAGE_KINDS else role: name for role, name in asked.items()}
    for role in asked:
        if role not in TYPES:
            raise InputError(f"unknown kind of topic; {nearest(role, list(TYPES))}", field="--topic")
    of_type = {
        role: [topic for topic in topics if topic.msgtype in types and topic.count] for role, types in TYPES.items()
    }
    names = {role: {topic.name for topic in found} for role, found in of_type.items()}
    stated = {role: name for role, name in stated.items() if name not in asked.values()}
    asked = {role: name for role, name in stated.items() if name in names.get(role, ())} | dict(asked)

    def one(role: str, fitting: Sequence[Topic]) -> Topic | None:
        """Return the topic that was asked for, else the only one that fits, None where none does."""
        if role in asked:
            fitting = [topic for topic in of_type[role] if topic.name == asked[role]][:1]
            if not fitting:
                found = _listed(of_type[role]) or "none of that type"
                raise InputError(f"expected one of the topics {found}, found {asked[role]!r}", path=path, field=role)
        if len(fitting) > 1:
            advice = f"choose with --topic {role}={fitting[0].name}"
            raise InputError(f"several topics fit: {_listed(fitting)}; {advice}", path=path)
        return fitting[0] if fitting else None

    def required(role: str, fitting: Sequence[Topic]) -> Topic:
        if topic := one(role, fitting):
            return topic
        found = _listed(topics) or "no topic at all"
        raise InputError(f"expected a topic of {' or '.join(TYPES[role])}, found {found}", path=path, field=role)

    image = required("image", [topic for topic in of_type["image"] if not topic.name.startswith(OUR_NAMES)])
    wheels = [topic for topic in of_type["odometry"] if topic.name != asked.get("groundtruth")]
    truths = [topic for topic in wheels if _TRUTH.search(topic.name) and topic.name != asked.get("odometry")]
    odometry = required("odometry", [topic for topic in wheels if topic not in truths])
    # Beside the image, or beside what was compressed.
    parent = image.name.rsplit("/", 1)[0]
    near = (f"{parent}/camera_info", f"{parent.rsplit('/', 1)[0]}/camera_info")
    beside = [topic for topic in of_type["camera_info"] if topic.name in near]
    fixed = [
        topic
        for topic in topics
        if topic.msgtype == TRANSFORMS
        and (topic.name.rsplit("/", 1)[-1] == "tf_static" or topic.name == stated.get("transforms"))
    ]
    moving = [
        topic
        for topic in topics
        if topic.msgtype == TRANSFORMS
        and (topic.name.rsplit("/", 1)[-1] == "tf" or topic.name == stated.get("moving_transforms"))
    ]
    single = {
        "image": image,
        "odometry": odometry,
        "camera_info": one("camera_info", beside or of_type["camera_info"]),
        "groundtruth": one("groundtruth", truths),
        "imu": one("imu", [topic for topic in of_type["imu"] if topic.name == IMU_TOPIC]),
    }
    roles = {topic: role for role, topic in single.items() if topic is not None}
    roles |= dict.fromkeys(moving, "moving_transforms") | dict.fromkeys(fixed, "transforms")
    return roles | {topic: topic.name for topic in topics if topic.msgtype == TEXT and topic.name in LABEL_TOPICS}


def _listed(topics: Sequence[Topic]) -> str:
    """Return names and types for a message, not more than can be read."""
    shown = [f"{topic.name} ({topic.msgtype.rsplit('/', 1)[-1]}, {topic.count})" for topic in topics[:_MOST_LISTED]]
    more = [f"and {len(topics) - _MOST_LISTED} more"] if len(topics) > _MOST_LISTED else []
    return ", ".join([*shown, *more])
