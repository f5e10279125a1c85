"""What can be published: a kind, its topic and type, and whether it is kept for those who subscribe later."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from localiser.documents import nearest
from localiser.errors import InputError
from localiser.storage.bags import (
    COMPRESSED,
    DIAGNOSTICS,
    MAP_TOPIC,
    MARKERS,
    PATH,
    POSE,
    POSES,
    TEXT,
    TRANSFORMS,
)


@dataclass(frozen=True, slots=True)
class Output:
    """A topic that is published. latched: the last message is kept for late subscribers (transient local).

    depth: how many messages a subscriber keeps by default (history of the quality of service).
    """

    kind: str
    topic: str
    msgtype: str
    latched: bool = False
    depth: int = 10


_ALL = (
    Output("pose", "/localiser/pose", POSE, latched=True, depth=1),
    Output("tf", "/tf", TRANSFORMS, depth=100),
    Output("particles", "/localiser/particles", POSES),
    Output("map", MAP_TOPIC, TEXT, latched=True, depth=1),
    Output("landmarks", "/localiser/landmarks", MARKERS, latched=True, depth=1),
    Output("matches", "/localiser/matches", MARKERS),
    Output("path", "/localiser/path", PATH),
    Output("image", "/localiser/image/compressed", COMPRESSED),
    Output("diagnostics", "/diagnostics", DIAGNOSTICS),
)

OUTPUTS: dict[str, Output] = {output.kind: output for output in _ALL}
"""Every kind by its name, with the topic that it has unless another is asked for."""


def topic_in(namespace: str, name: str | None) -> str:
    """Return a topic by ROS's rule: a name without a leading slash belongs to the namespace, such as `/robot1`."""
    return name or "" if not name or name.startswith("/") else f"{namespace}/{name}"


def outputs_named(names: Mapping[str, str | None] | None = None, namespace: str = "") -> dict[str, Output]:
    """Return all outputs, some with topics of another name; None leaves an output out.

    namespace: of all topics but those that are named with a leading slash. Raises InputError for an unknown kind.
    """
    names = names or {}
    for kind in names:
        if kind not in OUTPUTS:
            raise InputError(f"unknown kind of message; {nearest(kind, list(OUTPUTS))}", field="live.publish")
    asked = {
        kind: replace(output, topic=topic_in(namespace, names.get(kind, output.topic.removeprefix("/"))))
        for kind, output in OUTPUTS.items()
    }
    return {kind: output for kind, output in asked.items() if output.topic}
