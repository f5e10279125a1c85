"""A counterpart over DDS: Cyclone DDS with types of its own, written field by field, and none of our code.

python dds_counterpart.py DOMAIN hear|latched|mismatched
"""

import sys
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PATIENCE_S = 60.0
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


def quality(*, latched: bool = False, reliable: bool = True) -> Qos:
    return Qos(
        Policy.Reliability.Reliable(duration(seconds=1)) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(10),
        Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
    )


def main(domain: int, what: str) -> None:
    held = Domain(domain, LOOPBACK)
    participant = DomainParticipant(domain)
    pose = Stamped(
        Header(Time(12, 34), "map"), PoseWithCovariance(Pose(Point(1.5, -2.0, 0), Quaternion(0, 0, 0, 1)), [0.25] * 36)
    )
    if what == "hear":
        topic = Topic(participant, "rt/localiser/pose", Stamped)
        heard = DataReader(participant, topic, quality()).take_one(timeout=duration(seconds=PATIENCE_S))
        at = heard.pose.pose
        sys.stdout.write(f"{heard.header}\n{at.position}\n{heard.pose.covariance[0]}\n")
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
