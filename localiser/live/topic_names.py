"""Names of topics by what they are for; each topic is for one thing."""

from __future__ import annotations

from collections.abc import Mapping

from localiser.documents import nearest
from localiser.errors import InputError
from localiser.live.inbound import TOPICS
from localiser.ros import Output, topic_in


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


def check_outputs(topics: Mapping[str, str], outputs: Mapping[str, Output]) -> None:
    """Check that nothing goes out on a topic that comes in, nor two things on one topic. Raises InputError.

    topics: of what comes in, by role. All transforms that move are on one topic, those of the robot and our own.
    """
    shared = outputs["tf"].topic if "tf" in outputs else None
    incoming = [
        (f"what comes in as {role}", "live.topics", name)
        for role, name in topics.items()
        if not (role == "moving_transforms" and name == shared)
    ]
    outgoing = [(f"what goes out as {kind}", "live.publish", output.topic) for kind, output in outputs.items()]
    _check_apart(incoming + outgoing)


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
