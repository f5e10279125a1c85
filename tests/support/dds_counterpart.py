"""A counterpart over DDS: Cyclone DDS with types of its own, written field by field, and none of our code.

python dds_counterpart.py DOMAIN hear|recall|latched|mismatched|flood|ask|nodes
"""

import sys
import time
from dataclasses import dataclass

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, int64, sequence, uint8, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PATIENCE_S = 60.0
FLOOD = 2000
LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces></General>"
    "</Domain></CycloneDDS>"
)


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs.msg.dds_.Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class Stamped(IdlStruct, typename="geometry_msgs.msg.dds_.PoseWithCovarianceStamped_"):
    header: Header
    pose: PoseWithCovariance


@dataclass
class EmptyRequest(IdlStruct, typename="std_srvs.srv.dds_.Empty_Request_"):
    asker: uint64
    number: int64
    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class EmptyResponse(IdlStruct, typename="std_srvs.srv.dds_.Empty_Response_"):
    asker: uint64
    number: int64
    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common.msg.dds_.Gid_"):
    data: array[uint8, 16]


@dataclass
class NodeInfo(IdlStruct, typename="rmw_dds_common.msg.dds_.NodeEntitiesInfo_"):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]


@dataclass
class ParticipantInfo(IdlStruct, typename="rmw_dds_common.msg.dds_.ParticipantEntitiesInfo_"):
    gid: Gid
    node_entities_info_seq: sequence[NodeInfo]


def quality(*, latched: bool = False, reliable: bool = True) -> Qos:
    return Qos(
        Policy.Reliability.Reliable(duration(seconds=1)) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(10),
        Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
    )


def flood(participant: DomainParticipant, pose: Stamped) -> None:
    """Write many poses to whoever listens; say when they all have been received. Their seconds count them."""
    policy = Policy.History.KeepAll, Policy.Reliability.Reliable(duration(seconds=PATIENCE_S))
    everything = Qos(*policy, base=quality())
    writer = DataWriter(participant, Topic(participant, "rt/initialpose", Stamped), everything)
    while not writer.get_matched_subscriptions():
        time.sleep(0.02)
    for number in range(FLOOD):
        pose.header.stamp.sec = number
        writer.write(pose)
    writer.wait_for_acks(duration(seconds=PATIENCE_S))
    sys.stdout.write("received\n")
    sys.stdout.flush()
    sys.stdin.read()


def ask(participant: DomainParticipant) -> None:
    """Ask a service until it answers, as one must who may be there before it; print the answer."""
    name = "reinitialize_global_localization"
    requests = DataWriter(participant, Topic(participant, f"rq/{name}Request", EmptyRequest), quality())
    answers = DataReader(participant, Topic(participant, f"rr/{name}Reply", EmptyResponse), quality())
    for number in range(int(PATIENCE_S)):
        requests.write(EmptyRequest(2**63 + 5, number))
        answer = next(answers.take_iter(timeout=duration(seconds=1)), None)
        if answer is not None:
            sys.stdout.write(f"{answer.asker - 2**63} answered\n")
            return


def nodes(participant: DomainParticipant) -> None:
    """Print namespace and name of every node with its topics, once one has both a publisher and a subscriber."""
    seen = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
    subscribers = BuiltinDataReader(participant, BuiltinTopicDcpsSubscription)
    topic = Topic(participant, "ros_discovery_info", ParticipantInfo)
    reader = DataReader(participant, topic, quality(latched=True))
    end = time.monotonic() + PATIENCE_S
    names: dict[bytes, str] = {}
    while time.monotonic() < end:
        names |= {one.key.bytes: one.topic_name for one in (*seen.take(100), *subscribers.take(100))}
        for info in reader.read(10):
            for node in info.node_entities_info_seq:
                ours = [
                    [names.get(bytes(gid.data), "?") for gid in gids]
                    for gids in (node.writer_gid_seq, node.reader_gid_seq)
                ]
                if all(ours) and not any("?" in topics for topics in ours):
                    sys.stdout.write(f"{node.node_namespace} {node.node_name} {ours}\n")
                    return
        time.sleep(0.05)


def main(domain: int, what: str) -> None:
    held = Domain(domain, LOOPBACK)
    participant = DomainParticipant(domain)
    pose = Stamped(
        Header(Time(12, 34), "map"), PoseWithCovariance(Pose(Point(1.5, -2.0, 0), Quaternion(0, 0, 0, 1)), [0.25] * 36)
    )
    if what in ("hear", "recall"):
        topic = Topic(participant, "rt/localiser/pose", Stamped)
        reader = DataReader(participant, topic, quality(latched=what == "recall"))
        heard = reader.take_one(timeout=duration(seconds=PATIENCE_S))
        at = heard.pose.pose
        sys.stdout.write(f"{heard.header}\n{at.position}\n{heard.pose.covariance[0]}\n")
        return
    if what == "flood":
        flood(participant, pose)
        return
    if what in ("ask", "nodes"):
        (ask if what == "ask" else nodes)(participant)
        return
    topic = Topic(participant, "rt/initialpose", Stamped)
    writer = DataWriter(participant, topic, quality(latched=what == "latched", reliable=what != "mismatched"))
    writer.write(pose)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    sys.stdin.read()
    del held


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
