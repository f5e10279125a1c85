"""Topics over DDS, the default middleware of ROS 2, with Cyclone DDS and no ROS.

A topic `/odom` of ROS 2 is `rt/odom` there, and its type `nav_msgs::msg::dds_::Odometry_`. Messages pass as the bytes
that they are, CDR: a type is declared with its fields, by which others compare it with theirs, and is not used to
write or read.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache
from threading import Lock
from typing import Any
from xml.sax.saxutils import quoteattr

from localiser.errors import InputError
from localiser.live.transports.transport import Take, Topic
from localiser.storage.bags import typestore

LOOPBACK = "lo"
_RECEIVE_BYTES = 4 * 2**20
_MOST_AT_ONCE = 64
_POLICIES = {
    2: "durability",
    4: "deadline",
    8: "liveliness",
    11: "reliability",
    13: "history",
    23: "data representation",
    24: "type consistency",
}


class DdsTransport:
    """Takes part in a DDS domain. interface: the network interface; by default nothing leaves this machine."""

    def __init__(self, domain: int, interface: str = LOOPBACK) -> None:
        """Join a domain. Raises InputError, as when there is no such interface."""
        dds = _dds()
        self._report: Callable[[str], None] = lambda text: None
        self._lock = Lock()
        self._writers: dict[str, Any] = {}
        self._held: list[Any] = []
        try:
            self._domain = dds.domain.Domain(domain, _configuration(interface))
            self._participant = dds.domain.DomainParticipant(domain)
        except dds.core.DDSException:
            raise InputError(
                f"expected a network interface and a domain that no other part of this program uses, found "
                f"{interface!r} and {domain}",
                field="--dds",
            ) from None

    def report_to(self, report: Callable[[str], None]) -> None:
        """See `ReportsProblems`."""
        self._report = report

    def subscribe(self, topic: Topic, take: Take) -> None:
        """See `Transport`."""
        listener = _listener(
            lambda reader: _hand_over(reader, take), lambda policy: self._incompatible(topic, "publisher", policy)
        )
        reader = _dds().sub.DataReader(self._participant, self._made(topic), _qos(topic), listener=listener)
        self._held.append(reader)
        _hand_over(reader, take)  # what came before the listener heard of it

    def advertise(self, topic: Topic) -> None:
        """See `Transport`."""
        self._writer(topic)

    def publish(self, topic: Topic, content: bytes) -> None:
        """See `Transport`."""
        dds, writer = _dds(), self._writer(topic)
        try:
            writer.write(writer.topic.data_type(content))
        except dds.core.DDSException as error:
            if error.code != dds.core.DDSException.DDS_RETCODE_TIMEOUT:  # else a reader is too slow for it
                self._report(f"{topic.name}: a message was not sent: {error}")

    def is_heard(self, topic: Topic) -> bool:
        """See `Transport`."""
        return topic.latched or bool(self._writer(topic).get_matched_subscriptions())

    def close(self) -> None:
        """See `Transport`."""
        for entity in [*self._held, self._participant, self._domain]:
            entity._delete(entity._ref)  # children first; its own way is to wait for the garbage collection
        self._held.clear()
        self._writers.clear()

    def _writer(self, topic: Topic) -> Any:
        with self._lock:
            if topic.name not in self._writers:
                listener = _listener(None, lambda policy: self._incompatible(topic, "subscriber", policy))
                made = _dds().pub.DataWriter(self._participant, self._made(topic), _qos(topic), listener=listener)
                self._writers[topic.name] = made
                self._held.append(made)
            return self._writers[topic.name]

    def _made(self, topic: Topic) -> Any:
        return _dds().topic.Topic(self._participant, dds_name(topic), raw_type(topic.msgtype))

    def _incompatible(self, topic: Topic, other: str, policy: int) -> None:
        what = _POLICIES.get(policy, f"policy {policy}")
        self._report(f"{topic.name}: a {other} has another quality of service ({what}), so nothing passes between us")


def dds_name(topic: Topic) -> str:
    """Return the name of a topic as ROS 2 has it in DDS. Raises InputError."""
    name = topic.name.strip("/")
    if not name or not all(part.replace("_", "a").isalnum() and part.isascii() for part in name.split("/")):
        raise InputError(f"expected the name of a topic, found {topic.name!r}", field="--topic")
    return f"rt/{name}"


def dds_type(msgtype: str) -> str:
    """Return the name of a type of messages as ROS 2 has it in DDS."""
    package, _, name = msgtype.split("/")
    return f"{package}::msg::dds_::{name}_"


@cache
def raw_type(msgtype: str) -> Any:
    """Return a type of messages whose samples are their own bytes, and whose fields others can compare with theirs."""

    def begin(self: Any, content: bytes = b"") -> None:
        self.content = content

    made = _declared(msgtype)
    made.__init__ = begin
    made.serialize = lambda self, *_, **__: bytes(self.content)
    made.deserialize = classmethod(lambda cls, data, *_, **__: cls(bytes(data)))
    made.deserialize_key = classmethod(lambda cls, *_, **__: cls())  # of news of a publisher that goes
    return made


def _declared(msgtype: str) -> Any:
    """Return a type as Cyclone DDS declares it, with the fields that ROS has."""
    fields = {name: _field(*kind) for name, kind in typestore(ros1=False).fielddefs[msgtype][1]}
    name = dds_type(msgtype).replace("::", ".")
    return _dds().idl.make_idl_struct(name.rsplit(".", 1)[1], name, fields, dataclassify=False)


def _field(node: Any, of: Any) -> Any:
    from rosbags.interfaces import Nodetype

    types = _dds().idl.types
    if node == Nodetype.NAME:
        return _declared(of)
    if node == Nodetype.BASE:
        return {"string": str, "bool": bool}.get(of[0]) or getattr(types, of[0])
    inner, length = _field(*of[0]), of[1]
    return types.array[inner, length] if node == Nodetype.ARRAY else types.sequence[inner]


def _hand_over(reader: Any, take: Take) -> None:
    """Take everything that a reader has."""
    while samples := reader.take(_MOST_AT_ONCE):
        for sample in samples:
            if content := getattr(sample, "content", b""):
                take(content, struct.pack("<Q", sample.sample_info.publication_handle))


def _listener(came: Callable[[Any], None] | None, incompatible: Callable[[int], None]) -> Any:
    base: Any = _dds().core.Listener

    class Listener(base):  # type: ignore[misc]
        def on_requested_incompatible_qos(self, reader: Any, status: Any) -> None:
            incompatible(int(status.last_policy_id))

        def on_offered_incompatible_qos(self, writer: Any, status: Any) -> None:
            incompatible(int(status.last_policy_id))

    listener = Listener()
    if came is not None:
        listener.set_on_data_available(lambda reader: None if reader is None else came(reader))  # None: not yet made
    return listener


def _qos(topic: Topic) -> Any:
    """Return the quality of service: of a subscriber that hears whoever offers as much, and of a publisher."""
    dds = _dds()
    policy = dds.core.Policy
    reliable = topic.reliable or topic.latched
    return dds.core.Qos(
        policy.Reliability.Reliable(max_blocking_time=0) if reliable else policy.Reliability.BestEffort,
        policy.Durability.TransientLocal if topic.latched else policy.Durability.Volatile,
        policy.History.KeepLast(topic.depth),
        policy.DurabilityService(0, policy.History.KeepLast(topic.depth), -1, -1, -1),
        policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        policy.TypeConsistency.AllowTypeCoercion(force_type_validation=False),
    )


def _configuration(interface: str) -> str:
    name = quoteattr(interface)
    return (
        f"<CycloneDDS><Domain><General><Interfaces><NetworkInterface name={name} multicast='true'/></Interfaces>"
        f"</General><Internal><SocketReceiveBufferSize min='default' max='{_RECEIVE_BYTES}B'/></Internal>"
        "<Tracing><Verbosity>none</Verbosity></Tracing></Domain></CycloneDDS>"
    )


def _dds() -> Any:
    try:
        import cyclonedds.core
        import cyclonedds.domain
        import cyclonedds.idl.types
        import cyclonedds.pub
        import cyclonedds.sub
        import cyclonedds.topic
    except ImportError:
        raise InputError("expected the package cyclonedds; install it with: pip install '.[dds]' in a clone") from None
    return cyclonedds
