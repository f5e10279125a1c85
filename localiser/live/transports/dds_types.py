"""Types of ROS 2 as DDS declares them. Samples are their own bytes, CDR; fields are there to be compared."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from localiser.errors import InputError
from localiser.live.transports.transport import Topic
from localiser.storage.bags import typestore

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

ASKER_BYTES = 16
"""What stands before a request and its answer, after the four bytes of CDR's own: who asked, and how often before."""

_ASKER = "uint64 asker\nint64 number\n"


def dds() -> Any:
    """Return the package cyclonedds, which is loaded when it is first needed. Raises InputError."""
    try:
        import cyclonedds.builtin
        import cyclonedds.core
        import cyclonedds.domain
        import cyclonedds.idl.types
        import cyclonedds.pub
        import cyclonedds.sub
        import cyclonedds.topic
    except ImportError:
        raise InputError("expected the package cyclonedds; install it with: pip install '.[dds]' in a clone") from None
    return cyclonedds


def dds_name(topic: Topic) -> str:
    """Return the name of a topic as ROS 2 has it in DDS. Raises InputError."""
    return f"rt/{checked_name(topic.name, 'live.topics')}"


def checked_name(given: str, field: str) -> str:
    """Return the name of a topic or service without its first slash. Raises InputError."""
    name = given.strip("/")
    if not name or not all(part.replace("_", "a").isalnum() and part.isascii() for part in name.split("/")):
        raise InputError(f"expected the name of a topic, found {given!r}", field=field)
    return name


def dds_type(msgtype: str) -> str:
    """Return the name of a type of messages or services as DDS has it: `sensor_msgs::msg::dds_::Image_`."""
    package, kind, name = msgtype.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(name: str) -> str:
    """Return the type of messages of ROS 2 that has a name in DDS, such as nav_msgs/msg/Odometry."""
    return name.replace("::msg::dds_::", "/msg/").removesuffix("_")


@cache
def raw_type(msgtype: str) -> Any:
    """Return a type of messages whose samples are their own bytes, and whose fields others can compare with theirs."""
    return raw(typestore(ros1=False), msgtype, dds_type(msgtype))


@cache
def raw_part(srvtype: str, part: str, definition: str) -> Any:
    """Return the type of the requests or the answers of a service, as Cyclone's middleware of ROS 2 has it."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    package, _, name = srvtype.split("/")
    msgtype, store = f"{package}/msg/{name}_{part}", get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(f"{_ASKER}{definition}", msgtype))
    return raw(store, msgtype, dds_type(f"{srvtype}_{part}"))


def raw(store: Typestore, msgtype: str, name: str) -> Any:
    """Return a type of a store under its name in DDS."""

    def begin(self: Any, content: bytes = b"") -> None:
        self.content = content

    made = _declared(store, msgtype, name)
    made.__init__ = begin
    made.serialize = lambda self, *_, **__: bytes(self.content)
    made.deserialize = classmethod(lambda cls, data, *_, **__: cls(bytes(data)))
    made.deserialize_key = classmethod(lambda cls, *_, **__: cls())  # of news of a publisher that goes
    return made


def _declared(store: Typestore, msgtype: str, name: str) -> Any:
    """Return a type as Cyclone DDS declares it, with the fields that ROS has."""
    fields = {name: _field(store, *kind) for name, kind in store.fielddefs[msgtype][1]}
    dotted = name.replace("::", ".")
    return dds().idl.make_idl_struct(dotted.rsplit(".", 1)[1], dotted, fields, dataclassify=False)


def _field(store: Typestore, node: Any, of: Any) -> Any:
    from rosbags.interfaces import Nodetype

    types = dds().idl.types
    if node == Nodetype.NAME:
        return _declared(store, of, dds_type(of))
    if node == Nodetype.BASE:
        return {"string": str, "bool": bool, "char": types.uint8}.get(of[0]) or getattr(types, of[0])
    inner, length = _field(store, *of[0]), of[1]
    return types.array[inner, length] if node == Nodetype.ARRAY else types.sequence[inner]
