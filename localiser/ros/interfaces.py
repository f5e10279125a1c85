"""What a live run publishes and which services it answers: names, types, quality of service.

Where a type of a service is empty, ROS 2 writes one byte. Hashes are those of the service types, as ROS 2 has them from
Iron on (REP-2011, REP-2016).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from localiser.documents import nearest
from localiser.errors import InputError
from localiser.storage.bags import MAP_TOPIC, Messages, RosType

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic with its quality of service, as ROS 2 has it. name: begins with a slash. msgtype: `pkg/msg/Name`.

    latched: transient local, the last messages are kept for those who subscribe later. reliable: else best effort.
    depth: how many messages are kept.
    """

    name: str
    msgtype: str
    latched: bool = False
    reliable: bool = True
    depth: int = 10


OUTPUTS = {
    "pose": Topic("/localiser/pose", RosType.POSE, latched=True, depth=1),
    "tf": Topic("/tf", RosType.TRANSFORMS, depth=100),
    "particles": Topic("/localiser/particles", RosType.POSES),
    "map": Topic(MAP_TOPIC, RosType.TEXT, latched=True, depth=1),
    "landmarks": Topic("/localiser/landmarks", RosType.MARKERS, latched=True, depth=1),
    "matches": Topic("/localiser/matches", RosType.MARKERS),
    "path": Topic("/localiser/path", RosType.PATH),
    "places": Topic("/localiser/places", RosType.TEXT),
    "image": Topic("/localiser/image/compressed", RosType.COMPRESSED),
    "diagnostics": Topic("/diagnostics", RosType.DIAGNOSTICS),
}
"""Every kind by its name, with the topic that it has unless another is asked for."""

LAYOUTS = Path(__file__).parent / "layouts"
"""Files that show these topics: `localiser.rviz` for RViz 2, `foxglove.json` for Foxglove."""


def topic_in(namespace: str, name: str | None) -> str:
    """Return a topic by ROS's rule: a name without a leading slash belongs to the namespace, such as `/robot1`."""
    return name or "" if not name or name.startswith("/") else f"{namespace}/{name}"


def outputs_named(names: Mapping[str, str | None] | None = None, namespace: str = "") -> dict[str, Topic]:
    """Return all outputs, some with topics of another name; None leaves an output out.

    namespace: of all topics but those that are named with a leading slash. Raises InputError for an unknown kind.
    """
    names = names or {}
    for kind in names:
        if kind not in OUTPUTS:
            raise InputError(f"unknown kind of message; {nearest(kind, list(OUTPUTS))}", field="live.publish")
    asked = {
        kind: replace(output, name=topic_in(namespace, names.get(kind, output.name.removeprefix("/"))))
        for kind, output in OUTPUTS.items()
    }
    return {kind: output for kind, output in asked.items() if output.name}


_NOTHING = "uint8 structure_needs_at_least_one_member"


@dataclass(frozen=True, slots=True)
class Service:
    """A service. srvtype: `pkg/srv/Name`. type_hash: RIHS01 of the type, as ROS 2 has it from Iron on.

    request, response: what the two messages hold, as ROS writes definitions.
    """

    name: str
    srvtype: str
    type_hash: str
    request: str = _NOTHING
    response: str = _NOTHING


SERVICES = {
    "look_everywhere": Service(
        "/reinitialize_global_localization",
        "std_srvs/srv/Empty",
        "RIHS01_5888399dedec5ccc85ea6451949fd2c9f97bfdf963f9a588821639fcd31b5d19",
    ),
    "load_map": Service(
        "/localiser/load_map",
        "nav2_msgs/srv/LoadMap",
        "RIHS01_eb875de5ea9bb394573effc3f239015b19869dd7a8988136768372c6ef907ec1",
        "string map_url",
        "nav_msgs/OccupancyGrid map\nuint8 result",
    ),
}
"""Every service that a live run answers, by its kind."""

MAP_LOADED, MAP_NOT_THERE, MAP_INVALID = 0, 1, 2
"""Results of nav2_msgs/srv/LoadMap."""


def service_message(kind: str, part: str, content: bytes) -> Any:
    """Return the `Request` or `Response` (part) of a service. Raises ValueError when the content is none."""
    try:
        return _store().deserialize_cdr(content, _message_type(kind, part))
    except Exception as error:  # whatever bytes that are no message make of a decoder
        problem = f"expected a {part.lower()} of {SERVICES[kind].srvtype}, found {len(content)} bytes"
        raise ValueError(problem) from error


def service_bytes(kind: str, part: str, **fields: Any) -> bytes:
    """Return the bytes of the `Request` or `Response` (part) of a service; what is left out is zero or empty."""
    make = Messages()
    make.store = _store()
    return make.encode(make.make(_message_type(kind, part), **fields))


def _message_type(kind: str, part: str) -> str:
    package, _, name = SERVICES[kind].srvtype.split("/")
    return f"{package}/msg/{name}_{part}"


@cache
def _store() -> Typestore:
    """Return the definitions of all messages, with requests and answers among them."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind, service in SERVICES.items():
        for part, definition in (("Request", service.request), ("Response", service.response)):
            store.register(get_types_from_msg(definition, _message_type(kind, part)))
    return store
