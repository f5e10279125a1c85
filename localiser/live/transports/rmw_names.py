"""Names of topics and nodes on a zenoh network, as ROS 2's own middleware rmw_zenoh has them.

A message goes under `<domain>/<topic>/<type>/<hash of the type>`. Nodes, publishers, subscribers and services are
known to others by liveliness tokens below `@ros2_lv`. Every message carries an attachment of 33 bytes; a subscriber
drops one without it.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache

from localiser.live.transports.dds_types import dds_type
from localiser.live.transports.transport import Service, Topic
from localiser.storage.bags import typestore

NO_HASH = "TypeHashNotSupported"
"""What ROS 2 Humble has in the place of a type's hash."""

_ATTACHMENT = struct.Struct("<qqB16s")  # sequence number, time in ns, length of the gid, gid
_TYPE_MARK = "::dds_::"


@dataclass(frozen=True, slots=True)
class RmwNames:
    """Names of one node. domain: only nodes of the same one meet. namespace: "" or such as `/robot1`.

    hashes: whether types have a hash, as from ROS 2 Iron on; Humble has none.
    """

    domain: int = 0
    namespace: str = ""
    node: str = "localiser"
    hashes: bool = True

    def key(self, topic: Topic) -> str:
        """Return the key under which messages are sent."""
        return f"{self._stem(topic)}/{self._hash(topic)}"

    def pattern(self, topic: Topic) -> str:
        """Return the keys under which messages are awaited: of any hash, so that Humble is heard too."""
        return f"{self._stem(topic)}/*"

    @property
    def everything(self) -> str:
        """The keys of all messages in this domain."""
        return f"{self.domain}/**"

    def service_key(self, service: Service) -> str:
        """Return the key under which requests come."""
        return f"{self.domain}/{service.name.strip('/')}/{dds_type(service.srvtype)}/{self._service_hash(service)}"

    def node_token(self, zid: str) -> str:
        """Return the token by which others know the node. zid: of the zenoh session."""
        return self._node(zid, 0, "NN")

    def publisher_token(self, zid: str, number: int, topic: Topic) -> str:
        """Return the token of a publisher. number: unique in the session, above 0, which is the node's."""
        return f"{self._node(zid, number, 'MP')}/{self._topic(topic)}"

    def subscriber_token(self, zid: str, number: int, topic: Topic) -> str:
        """Return the token of a subscriber; number: see `publisher_token`."""
        return f"{self._node(zid, number, 'MS')}/{self._topic(topic)}"

    def service_token(self, zid: str, number: int, service: Service) -> str:
        """Return the token of a service; number: see `publisher_token`."""
        name, kind = mangled(service.name), dds_type(service.srvtype)
        return f"{self._node(zid, number, 'SS')}/{name}/{kind}/{self._service_hash(service)}/{quality(Topic('', ''))}"

    def topic_of(self, key: str) -> tuple[str, str | None]:
        """Return the topic of a key, and the type of its messages where the key tells it."""
        parts = key.split("/")
        if len(parts) >= 4 and _TYPE_MARK in parts[-2]:
            package, _, rest = parts[-2].partition("::")
            name = rest.rsplit("::", 1)[-1].removesuffix("_")
            return "/" + "/".join(parts[1:-2]), f"{package}/msg/{name}"
        return f"/{key}", None

    def _stem(self, topic: Topic) -> str:
        return f"{self.domain}/{topic.name.strip('/')}/{dds_type(topic.msgtype)}"

    def _node(self, zid: str, number: int, kind: str) -> str:
        return f"@ros2_lv/{self.domain}/{zid}/0/{number}/{kind}/%/{mangled(self.namespace)}/{self.node}"

    def _topic(self, topic: Topic) -> str:
        return f"{mangled(topic.name)}/{dds_type(topic.msgtype)}/{self._hash(topic)}/{quality(topic)}"

    def _hash(self, topic: Topic) -> str:
        return type_hash(topic.msgtype) if self.hashes else NO_HASH

    def _service_hash(self, service: Service) -> str:
        return service.type_hash if self.hashes else NO_HASH


def mangled(name: str) -> str:
    """Return a name as one part of a key: `%` stands for the slashes."""
    return "/".join(["", *name.strip("/").split("/")]).replace("/", "%")


@cache
def type_hash(msgtype: str) -> str:
    """Return the hash of a type (REP-2011), such as RIHS01_d31d41a9…"""
    return typestore(ros1=False).hash_rihs01(msgtype)


def quality(topic: Topic) -> str:
    """Return the quality of service as tokens have it; what is empty is the default.

    reliability (2: best effort), durability (1: transient local), history and depth, deadline, lifespan, liveliness.
    """
    return f"{'' if topic.reliable else 2}:{1 if topic.latched else ''}:,{topic.depth}:,:,:,,"


def gid_of(token: str) -> bytes:
    """Return the identity (16 bytes) of whoever a token is of: its XXH3-128, lower half first, little-endian."""
    import xxhash

    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")


def attachment(sequence: int, t_ns: int, gid: bytes) -> bytes:
    """Return the 33 bytes that go with a message. sequence: counts from 1. t_ns: when it is sent, by the calendar."""
    return _ATTACHMENT.pack(sequence, t_ns, len(gid), gid)


def parts_of(content: bytes) -> tuple[int, int, bytes]:
    """Return sequence number, time and gid of an attachment. Raises ValueError unless it is one."""
    if len(content) != _ATTACHMENT.size:
        raise ValueError(f"expected an attachment of {_ATTACHMENT.size} bytes, found {len(content)}")
    sequence, t_ns, length, gid = _ATTACHMENT.unpack(content)
    if length != len(gid):
        raise ValueError(f"expected a gid of {len(gid)} bytes, found {length}")
    return sequence, t_ns, gid
