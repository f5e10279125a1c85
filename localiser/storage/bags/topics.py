"""Choose which topic of a bag is what: by type, by names that are a custom, or by asking where several fit."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from localiser.documents import nearest
from localiser.errors import InputError
from localiser.storage.bags.bag import CAMERA_INFO, COMPRESSED, IMAGE, IMU, ODOMETRY, POSE, TEXT, Topic
from localiser.storage.bags.records import TRANSFORMS

LOG_TOPIC, MAP_TOPIC = "/localiser/log", "/localiser/map"
CAMERA_TOPIC, DECISIONS_TOPIC = "/localiser/camera", "/localiser/decisions"
STATE_TOPIC, IMU_TOPIC = "/localiser/state", "/localiser/imu"
OUR_NAMES = "/localiser/"
"""What is in the names of this program's own topics, in any namespace: no source of images, unless asked for."""
LABEL_TOPICS = (LOG_TOPIC, MAP_TOPIC, CAMERA_TOPIC, DECISIONS_TOPIC, STATE_TOPIC)
_POSES = (ODOMETRY, POSE, "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped")
TYPES = {
    "image": (IMAGE, COMPRESSED),
    "camera_info": (CAMERA_INFO,),
    "odometry": _POSES,
    "groundtruth": _POSES,
    "imu": (IMU,),
}
IMAGE_KINDS = ("image_raw", "image_rect")
"""Images by what was done to them: their lens distortion is as the camera took them, or undone."""
TIMES = "times"
"""A choice that is no topic: `times=recorded` takes when messages were recorded, not the stamps in their headers."""
TRUTH_FRAME = "truth of a frame"
_TRUTH = re.compile(r"ground_?truth|(?:^|[/_])(?:gt|truth|mocap|vicon|optitrack|qualisys)(?:[/_]|$)", re.IGNORECASE)
_MOST_LISTED = 12


def choose(
    path: Path,
    topics: Sequence[Topic],
    asked: Mapping[str, str],
    stated: Mapping[str, str],
    is_picture: Callable[[Topic], bool] = lambda topic: True,
) -> dict[Topic, str]:
    """Return the topics of a log and what each is for; one that this program adds to a bag stands for itself.

    asked: names by what they are for, which come before any guess; of images also by IMAGE_KINDS. stated: the same,
    as the bag says. is_picture: whether the images of a topic show light, not depth.

    Poses whose name says ground truth are the truth, if they are the only ones; a frame of /tf can be asked for in
    place of a topic. Of several camera_info the one nearest to the image is taken, as ROS names them. An inertial
    sensor is taken only where it was asked for. Raises InputError that lists the choices when several fit or none does.
    """
    asked = {"image" if role in IMAGE_KINDS else role: name for role, name in asked.items() if role != TIMES}
    for role in asked:
        if role not in TYPES:
            raise InputError(f"unknown kind of topic; {nearest(role, [*TYPES, TIMES])}", field="--topic")
    of_type = {
        role: [topic for topic in topics if topic.msgtype in types and topic.count] for role, types in TYPES.items()
    }
    names = {role: {topic.name for topic in found} for role, found in of_type.items()}
    stated = {role: name for role, name in stated.items() if name not in asked.values()}
    asked = {role: name for role, name in stated.items() if name in names.get(role, ())} | asked
    transforms = {
        role: [
            topic
            for topic in topics
            if topic.msgtype == TRANSFORMS
            and (topic.name.rsplit("/", 1)[-1] == ending or topic.name == stated.get(role))
        ]
        for role, ending in (("moving_transforms", "tf"), ("transforms", "tf_static"))
    }

    def one(role: str, fitting: Sequence[Topic]) -> Topic | None:
        """Return the topic that was asked for, else the only one that fits, None where none does."""
        if role in asked:
            fitting = [topic for topic in of_type[role] if topic.name == asked[role]][:1]
            if not fitting and not (role == "groundtruth" and transforms["moving_transforms"]):
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
        raise InputError(f"expected a topic of {' or '.join(TYPES[role][:2])}, found {found}", path=path, field=role)

    image = required("image", [] if "image" in asked else _pictures(of_type["image"], is_picture))
    wheels = [topic for topic in of_type["odometry"] if topic.name != asked.get("groundtruth")]
    truths = [topic for topic in wheels if _TRUTH.search(topic.name) and topic.name != asked.get("odometry")]
    wheels = [topic for topic in wheels if topic.msgtype == ODOMETRY and topic not in truths]
    single = {
        "image": image,
        "odometry": required("odometry", wheels),
        "camera_info": one("camera_info", _nearest_to(image.name, of_type["camera_info"])),
        "groundtruth": one("groundtruth", truths if len(truths) == 1 else []),
        "imu": one("imu", [topic for topic in of_type["imu"] if topic.name == IMU_TOPIC]),
    }
    roles = {topic: role for role, topic in single.items() if topic is not None}
    roles |= {topic: role for role, found in transforms.items() for topic in found}
    return roles | {topic: topic.name for topic in topics if topic.msgtype == TEXT and topic.name in LABEL_TOPICS}


def choice_text(roles: Mapping[Topic, str], topics: Sequence[Topic]) -> str:
    """Return in one line what was chosen, and which topics say by their name that they are a truth and are not used."""
    chosen = [f"{role} {topic.name}" for topic, role in roles.items() if role in TYPES or role.endswith("transforms")]
    spare = [one for one in topics if one.msgtype in _POSES and _TRUTH.search(one.name) and one not in roles]
    more = f"; not used: {_listed(spare)}, see --topic groundtruth={spare[0].name}" if spare else ""
    return f"taken: {', '.join(chosen)}{more}"


def _pictures(images: Sequence[Topic], is_picture: Callable[[Topic], bool]) -> list[Topic]:
    """Return the topics that may be the camera's: pictures, which are not our own, without copies of one that is there.

    Where there are others, names that speak of depth are not proposed.
    """
    found = [topic for topic in images if OUR_NAMES not in topic.name and is_picture(topic)]
    names = {topic.name for topic in found}
    found = [topic for topic in found if topic.name.removesuffix("/compressed") not in names - {topic.name}]
    return [topic for topic in found if not speaks_of_depth(topic.name)] or found


def speaks_of_depth(name: str) -> bool:
    """Whether the name of a topic has a word for images of distances."""
    return bool({"depth", "disparity", "compresseddepth"} & set(re.split(r"[/_]", name.lower())))


def _nearest_to(image: str, infos: Sequence[Topic]) -> Sequence[Topic]:
    """Return the camera_info beside the image, or beside what was compressed; all where none is near."""
    parent = image.rsplit("/", 1)[0]
    for place in (parent, parent.rsplit("/", 1)[0]):
        if beside := [topic for topic in infos if topic.name == f"{place}/camera_info"]:
            return beside
    return infos


def _listed(topics: Sequence[Topic]) -> str:
    """Return names and types for a message, not more than can be read."""
    shown = [f"{topic.name} ({topic.msgtype.rsplit('/', 1)[-1]}, {topic.count})" for topic in topics[:_MOST_LISTED]]
    more = [f"and {len(topics) - _MOST_LISTED} more"] if len(topics) > _MOST_LISTED else []
    return ", ".join([*shown, *more])
