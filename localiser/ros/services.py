"""Services of a live run: names, types, and how their requests and answers are written.

Where a type is empty, ROS 2 writes one byte. Hashes are those of the service types, as ROS 2 has them from Iron on
(REP-2011, REP-2016).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

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


def request_of(kind: str, content: bytes) -> Any:
    """Return the request of a service. Raises ValueError when the content is none."""
    try:
        return _store().deserialize_cdr(content, _message(kind, "Request"))
    except Exception as error:  # whatever bytes that are no message make of a decoder
        raise ValueError(f"expected a request of {SERVICES[kind].srvtype}, found {len(content)} bytes") from error


def request_bytes(kind: str, **fields: Any) -> bytes:
    """Return a request of a service; what is left out is zero or empty."""
    return _bytes(_message(kind, "Request"), fields)


def response_bytes(kind: str, **fields: Any) -> bytes:
    """Return an answer of a service; what is left out is zero or empty."""
    return _bytes(_message(kind, "Response"), fields)


def response_of(kind: str, content: bytes) -> Any:
    """Return the answer of a service. Raises whatever bytes that are none make of a decoder."""
    return _store().deserialize_cdr(content, _message(kind, "Response"))


def _bytes(msgtype: str, fields: dict[str, Any]) -> bytes:
    from localiser.storage.bags import Messages

    make = Messages()
    make.store = _store()
    return make.encode(make.make(msgtype, **fields))


def _message(kind: str, part: str) -> str:
    package, _, name = SERVICES[kind].srvtype.split("/")
    return f"{package}/msg/{name}_{part}"


@cache
def _store() -> Typestore:
    """Return the definitions of all messages, with requests and answers among them."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind, service in SERVICES.items():
        store.register(get_types_from_msg(service.request, _message(kind, "Request")))
        store.register(get_types_from_msg(service.response, _message(kind, "Response")))
    return store
