"""Topics over DDS, the default middleware of ROS 2, with Cyclone DDS and no ROS.

A topic `/odom` of ROS 2 is `rt/odom` there, and its type `nav_msgs::msg::dds_::Odometry_`. Messages pass as the bytes
that they are, CDR: a type is declared with its fields, by which others compare it with theirs, and is not used to
write or read. Which topics belong to which node, DDS does not tell, so every participant says it on
`ros_discovery_info`: the names of its nodes, with the identities of their publishers and subscribers.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

import numpy as np

from localiser.errors import InputError
from localiser.live.transport import Reply, Service, Take, Topic, checked_name, dds_type
from localiser.storage.bags import typestore

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_RECEIVE_BYTES = 4 * 2**20
_POLICIES = {
    2: "durability",
    4: "deadline",
    8: "liveliness",
    11: "reliability",
    13: "history",
    23: "data representation",
    24: "type consistency",
}
_MOST_AT_ONCE, _LONGEST_NS = 64, 10**9  # messages that are handed over before others have their turn
_DISCOVERY = "ros_discovery_info"
_INFO, _NODE, _GID = (f"rmw_dds_common/msg/{name}" for name in ("ParticipantEntitiesInfo", "NodeEntitiesInfo", "Gid"))
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
    return f"rt/{checked_name(topic.name)}"


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


class Readers:
    """The subscribers of a participant. One thread hands their messages over, in the order in which each received them.

    The threads of Cyclone DDS that read the network do not wait for it. In a flood it is therefore the subscriber that
    drops the oldest messages, by its depth, and no buffer of a socket keeps thousands of them until they are of no use.
    """

    def __init__(self, participant: Any, report: Callable[[str], None]) -> None:
        """Begin with none. report: takes what went wrong."""
        core = dds().core
        self._report, self._stopped = report, False
        self._taken: list[tuple[Any, Any, Callable[[Any], None]]] = []
        self._wait, self._stop = core.WaitSet(participant), core.GuardCondition(participant)
        self._wait.attach(self._stop)
        self._thread = Thread(target=self._run, name="dds", daemon=True)
        self._thread.start()

    def add(self, reader: Any, take: Callable[[Any], None]) -> None:
        """Hand over every sample that a reader has, and will receive."""
        core = dds().core
        anything = core.SampleState.Any | core.ViewState.Any | core.InstanceState.Any
        condition = core.ReadCondition(reader, anything)
        self._taken.append((condition, reader, take))
        self._wait.attach(condition)

    def close(self) -> None:
        """Stop; nothing is handed over any more."""
        self._stopped = True
        self._stop.set(True)
        self._thread.join()
        for condition, _, _ in self._taken:
            self._wait.detach(condition)
            condition._delete(condition._ref)
        self._wait.detach(self._stop)
        for entity in (self._stop, self._wait):
            entity._delete(entity._ref)

    def _run(self) -> None:
        while not self._stopped:
            self._wait.wait(_LONGEST_NS)
            for condition, reader, take in tuple(self._taken):
                if not self._stopped and condition.triggered:
                    self._hand_over(reader, take)

    def _hand_over(self, reader: Any, take: Callable[[Any], None]) -> None:
        """Take what a reader has, and no more at once than leaves time for the others."""
        try:
            samples = reader.take(_MOST_AT_ONCE)
        except dds().core.DDSException as error:
            self._report(f"{reader.topic.name}: messages could not be read: {error}")
            return
        for sample in samples:
            take(sample)


class Node:
    """Tells others of one node. namespace: begins with a slash. humble: identities are longer there (24 bytes)."""

    def __init__(self, participant: Any, name: str, namespace: str, humble: bool) -> None:
        """Tell of a node that has no topics yet."""
        from rosbags.typesys import Stores, get_typestore

        package = dds()
        self._store = get_typestore(Stores.ROS2_HUMBLE if humble else Stores.ROS2_JAZZY)
        self._participant, self._name, self._namespace = participant, name, namespace
        self._lock = Lock()
        self._ours: tuple[list[Any], list[Any]] = [], []
        topic = package.topic.Topic(participant, _DISCOVERY, raw(self._store, _INFO, dds_type(_INFO)))
        quality = _qos(Topic(_DISCOVERY, _INFO, latched=True, depth=1))
        self._writer = package.pub.DataWriter(participant, topic, quality)
        self._tell()

    def has(self, reader: Any = None, writer: Any = None) -> None:
        """Tell that a subscriber or a publisher belongs to the node."""
        with self._lock:
            for ours, new in zip(self._ours, (reader, writer), strict=True):
                if new is not None:
                    ours.append(self._gid(new))
            self._tell()

    def _tell(self) -> None:
        types = self._store.types
        readers, writers = self._ours
        node = types[_NODE](self._namespace, self._name, readers, writers)
        info = types[_INFO](self._gid(self._participant), [node])
        content = bytes(self._store.serialize_cdr(info, _INFO))
        self._writer.write(self._writer.topic.data_type(content))

    def _gid(self, entity: Any) -> Any:
        make = self._store.types[_GID]
        length = self._store.fielddefs[_GID][1][0][1][1][1]
        return make(np.frombuffer(entity.get_guid().bytes.ljust(length, b"\0"), dtype=np.uint8))


class DdsTransport:
    """Takes part in a DDS domain as a node. interface: of the network; by default nothing leaves this machine.

    namespace: of the node, "" or such as `/robot1`. humble: whether the others are ROS 2 Humble, for the node's name.
    """

    def __init__(
        self, domain: int, interface: str, node: str = "localiser", namespace: str = "", *, humble: bool = False
    ) -> None:
        """Join a domain. Raises InputError, as when there is no such interface."""
        package = dds()
        self._report: Callable[[str], None] = lambda text: None
        self._lock = Lock()
        self._writers: dict[str, Any] = {}
        self._held: list[Any] = []
        try:
            self._domain = package.domain.Domain(domain, _configuration(interface))
            ours = package.core.Qos(package.core.Policy.Userdata(b"enclave=/;"))
            self._participant = package.domain.DomainParticipant(domain, ours)
        except package.core.DDSException:
            raise InputError(
                f"expected a network interface and a domain that no other part of this program uses, found "
                f"{interface!r} and {domain}",
                field="live.dds",
            ) from None
        self._node = Node(self._participant, node, namespace or "/", humble)
        self._readers = Readers(self._participant, self._tell)

    def _tell(self, problem: str) -> None:
        self._report(problem)  # who takes reports may still change

    def is_joined(self) -> bool:
        """See `Transport`."""
        return True

    def report_to(self, report: Callable[[str], None]) -> None:
        """See `Transport`."""
        self._report = report

    def subscribe(self, topic: Topic, take: Take) -> None:
        """See `Transport`."""
        self._read(topic, dds_name(topic), raw_type(topic.msgtype), take)

    def advertise(self, topic: Topic) -> None:
        """See `Transport`."""
        self._writer(topic)

    def publish(self, topic: Topic, content: bytes) -> None:
        """See `Transport`."""
        self._send(topic.name, self._writer(topic), content)

    def is_heard(self, topic: Topic) -> bool:
        """See `Transport`."""
        return topic.latched or bool(self._writer(topic).get_matched_subscriptions())

    def serve(self, service: Service, take: Callable[[bytes, Reply], None]) -> None:
        """See `Transport`. Requests come, and answers go, as Cyclone's middleware of ROS 2 has them."""
        name, quality = checked_name(service.name, "live.services"), Topic(service.name, service.srvtype)
        answers = raw_part(service.srvtype, "Response", service.response)
        writer = self._write(quality, f"rr/{name}Reply", answers)

        def handle(content: bytes, _source: bytes) -> None:
            kind, asker, request = content[:4], content[4 : 4 + ASKER_BYTES], content[4 + ASKER_BYTES :]
            take(kind + request, lambda answer: self._send(service.name, writer, answer[:4] + asker + answer[4:]))

        self._read(quality, f"rq/{name}Request", raw_part(service.srvtype, "Request", service.request), handle)

    def listen_to_all(self, take: Callable[[str, str | None, bytes], None]) -> None:
        """See `Transport`. Topics whose types are not known are left out."""
        own, known = self._participant.get_guid(), set[str]()

        def found(publication: Any) -> None:
            name, kind = publication.topic_name or "", publication.type_name or ""
            msgtype = kind.replace("::msg::dds_::", "/msg/").removesuffix("_")
            if publication.participant_key == own or not name.startswith("rt/") or name in known:
                return
            known.add(name)
            if msgtype in typestore(ros1=False).fielddefs:
                topic = Topic(name.removeprefix("rt"), msgtype, reliable=False)
                self.subscribe(topic, lambda content, source: take(topic.name, msgtype, content))

        package = dds().builtin
        reader = package.BuiltinDataReader(self._participant, package.BuiltinTopicDcpsPublication)
        self._held.append(reader)
        self._readers.add(reader, found)

    def close(self) -> None:
        """See `Transport`."""
        self._readers.close()
        for entity in [*self._held, self._participant, self._domain]:
            entity._delete(entity._ref)  # children first; its own way is to wait for the garbage collection
        self._held.clear()
        self._writers.clear()

    def _writer(self, topic: Topic) -> Any:
        with self._lock:
            if topic.name not in self._writers:
                self._writers[topic.name] = self._write(topic, dds_name(topic), raw_type(topic.msgtype))
            return self._writers[topic.name]

    def _write(self, topic: Topic, name: str, kind: Any) -> Any:
        listener = _listener(lambda policy: self._incompatible(topic, "subscriber", policy))
        made = dds().topic.Topic(self._participant, name, kind)
        writer = dds().pub.DataWriter(self._participant, made, _qos(topic), listener=listener)
        self._held.append(writer)
        self._node.has(writer=writer)
        return writer

    def _read(self, topic: Topic, name: str, kind: Any, take: Take) -> None:
        listener = _listener(lambda policy: self._incompatible(topic, "publisher", policy))
        made = dds().topic.Topic(self._participant, name, kind)
        reader = dds().sub.DataReader(self._participant, made, _qos(topic), listener=listener)
        self._held.append(reader)
        self._node.has(reader=reader)

        def hand_over(sample: Any) -> None:
            if content := getattr(sample, "content", b""):  # none: news of a publisher that goes
                take(content, struct.pack("<Q", sample.sample_info.publication_handle))

        self._readers.add(reader, hand_over)

    def _send(self, name: str, writer: Any, content: bytes) -> None:
        error_kind = dds().core.DDSException
        try:
            writer.write(writer.topic.data_type(content))
        except error_kind as error:
            if error.code != error_kind.DDS_RETCODE_TIMEOUT:  # else a reader is too slow for it
                self._report(f"{name}: a message was not sent: {error}")

    def _incompatible(self, topic: Topic, other: str, policy: int) -> None:
        what = _POLICIES.get(policy, f"policy {policy}")
        self._report(f"{topic.name}: a {other} has another quality of service ({what}), so nothing passes between us")


def _listener(incompatible: Callable[[int], None]) -> Any:
    base: Any = dds().core.Listener

    class Listener(base):  # type: ignore[misc]
        def on_requested_incompatible_qos(self, reader: Any, status: Any) -> None:
            incompatible(int(status.last_policy_id))

        def on_offered_incompatible_qos(self, writer: Any, status: Any) -> None:
            incompatible(int(status.last_policy_id))

    return Listener()


def _qos(topic: Topic) -> Any:
    """Return the quality of service: of a subscriber that hears whoever offers as much, and of a publisher."""
    package = dds()
    policy = package.core.Policy
    reliable = topic.reliable or topic.latched
    return package.core.Qos(
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
