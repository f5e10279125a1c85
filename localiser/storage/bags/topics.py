"""Which topic of a bag is what: by type, by name only where names are a custom, and by asking where several fit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from localiser.documents import nearest
from localiser.errors import InputError
from localiser.storage.bags.bag import CAMERA_INFO, COMPRESSED, IMAGE, ODOMETRY, TEXT, TRANSFORMS, Topic

LOG_TOPIC, MAP_TOPIC = "/localiser/log", "/localiser/map"
CAMERA_TOPIC, DECISIONS_TOPIC = "/localiser/camera", "/localiser/decisions"
STATE_TOPIC = "/localiser/state"
LABEL_TOPICS = (LOG_TOPIC, MAP_TOPIC, CAMERA_TOPIC, DECISIONS_TOPIC, STATE_TOPIC)
TYPES = {
    "image": (IMAGE, COMPRESSED),
    "camera_info": (CAMERA_INFO,),
    "odometry": (ODOMETRY,),
    "groundtruth": (ODOMETRY,),
}
_TRUTH = re.compile(r"ground_?truth", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """The topics that a log is read from. labels: what this program adds to a bag."""

    image: Topic
    odometry: Topic
    camera_info: Topic | None
    groundtruth: Topic | None
    transforms: tuple[Topic, ...]
    labels: tuple[Topic, ...]

    @property
    def all(self) -> list[Topic]:
        """All of them."""
        single = (self.image, self.odometry, self.camera_info, self.groundtruth)
        return [topic for topic in single if topic is not None] + [*self.transforms, *self.labels]


def choose(path: Path, topics: Sequence[Topic], asked: Mapping[str, str]) -> Chosen:
    """Return the topics of a log; asked: names by what they are for, which come before any guess.

    An odometry whose name says ground truth is the truth. Of several camera_info the one beside the image is taken, as
    ROS names them. Raises InputError that lists the choices when several fit or none does.
    """
    for role in asked:
        if role not in TYPES:
            raise InputError(f"unknown kind of topic; {nearest(role, list(TYPES))}", field="--topic")
    image = _required(path, topics, asked, "image", _of_type(topics, "image"))
    wheels = [topic for topic in _of_type(topics, "odometry") if topic.name != asked.get("groundtruth")]
    truths = [topic for topic in wheels if _TRUTH.search(topic.name) and topic.name != asked.get("odometry")]
    odometry = _required(path, topics, asked, "odometry", [topic for topic in wheels if topic not in truths])
    cameras = _of_type(topics, "camera_info")
    beside = [topic for topic in cameras if topic.name in _beside(image.name)]
    return Chosen(
        image=image,
        odometry=odometry,
        camera_info=_one(path, topics, asked, "camera_info", beside or cameras),
        groundtruth=_one(path, topics, asked, "groundtruth", truths),
        transforms=tuple(
            topic for topic in topics if topic.msgtype == TRANSFORMS and topic.name.rsplit("/", 1)[-1] == "tf_static"
        ),
        labels=tuple(topic for topic in topics if topic.msgtype == TEXT and topic.name in LABEL_TOPICS),
    )


def _beside(image: str) -> tuple[str, ...]:
    """Return what the camera_info of an image topic is called: beside it, or beside what was compressed."""
    parent = image.rsplit("/", 1)[0]
    return f"{parent}/camera_info", f"{parent.rsplit('/', 1)[0]}/camera_info"


def _of_type(topics: Sequence[Topic], role: str) -> list[Topic]:
    return [topic for topic in topics if topic.msgtype in TYPES[role] and topic.count]


def _required(
    path: Path, topics: Sequence[Topic], asked: Mapping[str, str], role: str, fitting: Sequence[Topic]
) -> Topic:
    topic = _one(path, topics, asked, role, fitting)
    if topic is None:
        found = _listed(topics) or "no topic at all"
        raise InputError(f"expected a topic of {' or '.join(TYPES[role])}, found {found}", path=path, field=role)
    return topic


def _one(
    path: Path, topics: Sequence[Topic], asked: Mapping[str, str], role: str, fitting: Sequence[Topic]
) -> Topic | None:
    """Return the topic that was asked for, else the only one that fits, None where none does."""
    if role in asked:
        named = [topic for topic in _of_type(topics, role) if topic.name == asked[role]]
        if not named:
            found = _listed(_of_type(topics, role)) or "none of that type"
            raise InputError(f"expected one of the topics {found}, found {asked[role]!r}", path=path, field=role)
        return named[0]
    if len(fitting) > 1:
        raise InputError(
            f"several topics fit: {_listed(fitting)}; choose with --topic {role}={fitting[0].name}", path=path
        )
    return fitting[0] if fitting else None


def _listed(topics: Sequence[Topic], longest: int = 12) -> str:
    """Return names and types for a message, not more than can be read."""
    shown = [f"{topic.name} ({topic.msgtype.rsplit('/', 1)[-1]}, {topic.count})" for topic in topics[:longest]]
    more = [f"and {len(topics) - longest} more"] if len(topics) > longest else []
    return ", ".join([*shown, *more])
