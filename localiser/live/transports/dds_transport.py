"""Topics over DDS, the default middleware of ROS 2, with Cyclone DDS and no ROS.

A topic `/odom` of ROS 2 is `rt/odom` there, and its type `nav_msgs::msg::dds_::Odometry_`. Messages pass as the bytes
that they are, CDR: a type is declared with its fields, by which others compare it with theirs, and is not used to
write or read.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any
from xml.sax.saxutils import quoteattr

from localiser.errors import InputError
from localiser.live.transports.dds_graph import Node, Publications
from localiser.live.transports.dds_readers import Readers
from localiser.live.transports.dds_types import ASKER_BYTES, checked_name, dds, dds_name, raw_part, raw_type
from localiser.live.transports.transport import Reply, Service, Take, Topic
from localiser.storage.bags import typestore

LOOPBACK = "lo"
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


class DdsTransport:
    """Takes part in a DDS domain as a node. interface: of the network; by default nothing leaves this machine.

    namespace: of the node, "" or such as `/robot1`. humble: whether the others are ROS 2 Humble, for the node's name.
    """

    def __init__(
        self,
        domain: int,
        interface: str = LOOPBACK,
        node: str = "localiser",
        namespace: str = "",
        *,
        humble: bool = False,
    ) -> None:
        """Join a domain. Raises InputError, as when there is no such interface."""
        package = dds()
        self._report: Callable[[str], None] = lambda text: None
        self._lock = Lock()
        self._writers: dict[str, Any] = {}
        self._held: list[Any] = []
        self._publications: list[Publications] = []
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

    def report_to(self, report: Callable[[str], None]) -> None:
        """See `ReportsProblems`."""
        self._report = report

    def _tell(self, problem: str) -> None:
        self._report(problem)  # to whom it is told may still change

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
        """See `ServesRequests`. Requests come, and answers go, as Cyclone's middleware of ROS 2 has them."""
        name, quality = checked_name(service.name, "live.services"), Topic(service.name, service.srvtype)
        answers = raw_part(service.srvtype, "Response", service.response)
        writer = self._write(quality, f"rr/{name}Reply", answers)

        def handle(content: bytes, _source: bytes) -> None:
            kind, asker, request = content[:4], content[4 : 4 + ASKER_BYTES], content[4 + ASKER_BYTES :]
            take(kind + request, lambda answer: self._send(service.name, writer, answer[:4] + asker + answer[4:]))

        self._read(quality, f"rq/{name}Request", raw_part(service.srvtype, "Request", service.request), handle)

    def listen_to_all(self, take: Callable[[str, str | None, bytes], None]) -> None:
        """See `HearsAll`. Topics whose types are not known are left out."""

        def found(name: str, msgtype: str) -> None:
            if msgtype in typestore(ros1=False).fielddefs:
                topic = Topic(name, msgtype, reliable=False)
                self.subscribe(topic, lambda content, source: take(name, msgtype, content))

        self._publications.append(Publications(self._participant, found))

    def close(self) -> None:
        """See `Transport`."""
        for publications in self._publications:
            publications.close()
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
        self._readers.add(reader, take)

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
