"""Publish what a live run finds out: what somebody listens to, or what is recorded, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from localiser.camera import Camera
from localiser.filter import LocatedFrame
from localiser.landmarks import LandmarkMap
from localiser.live.transports import Topic, Transport
from localiser.ros import Frames, Message, Outgoing, Output

RECORDED = frozenset(("tf", "diagnostics"))
"""What is made for a recording also when nobody listens, as is what is latched; a replay makes the rest again."""

Record = Callable[[str, str, bytes], None]
"""Takes topic, type and content of a message that went out."""


@dataclass(slots=True, eq=False)
class Publisher:
    """Publishes on a transport. outputs: what may go out, under which names. record: None without a recording.

    frames: names; an empty one of the odometry's frame stands for the one that the odometry has. tolerance_ns: by how
    much transforms are post-dated.
    """

    transport: Transport
    outputs: Mapping[str, Output]
    frames: Frames = field(default_factory=lambda: Frames(odom=""))
    tolerance_ns: int = 200_000_000
    record: Record | None = None
    _outgoing: Outgoing | None = None
    _topics: dict[str, Topic] = field(init=False)
    _newest_ns: int = -1
    _followed_ns: int = -1
    _odometry_frame: str = ""

    def __post_init__(self) -> None:
        self._topics = {
            kind: Topic(output.topic, output.msgtype, latched=output.latched, depth=output.depth)
            for kind, output in self.outputs.items()
        }
        for topic in self._topics.values():
            self.transport.advertise(topic)

    def begin(self, landmark_map: LandmarkMap, camera: Camera, stamp_ns: int) -> None:
        """Begin, or begin anew with another map: what was located before says nothing any more."""
        self._outgoing = Outgoing(landmark_map, camera, self.frames, self.tolerance_ns, tuple(self.outputs))
        self._name_odometry()
        self._send([*self._outgoing.map(stamp_ns), *self._outgoing.landmarks(stamp_ns)])

    def forget(self) -> None:
        """Forget what was located, because the robot is somewhere else."""
        if self._outgoing is not None:
            self._outgoing.forget()

    def image(self, found: LocatedFrame, stamp_ns: int, facts: Mapping[str, str], frame: str) -> None:
        """Publish what was located in an image. facts: more for the diagnostics. stamp_ns, frame: of the image."""
        if self._outgoing is None:
            return
        self._outgoing.camera_frame(frame)
        self._send(self._outgoing.image(found, stamp_ns, self._is_wanted, facts))
        if self._newest_ns > self._followed_ns:  # the first image, or the first that is trusted again
            self._follow()

    def wheels(self, stamp_ns: int, frame: str) -> None:
        """Publish the transform for a pose of the wheels, unless one as new is out. frame: the odometry's."""
        if stamp_ns <= self._newest_ns:
            return
        if frame != self._odometry_frame:
            self._odometry_frame = frame
            self._name_odometry()
        self._newest_ns = stamp_ns
        self._follow()

    def clock_jumped(self) -> None:
        """Take stamps that begin anew."""
        self._newest_ns = self._followed_ns = -1

    def _follow(self) -> None:
        """Publish the transform for the newest pose of the wheels, if the robot is found."""
        messages = [] if self._outgoing is None else self._outgoing.transform(self._newest_ns)
        if messages:
            self._followed_ns = self._newest_ns
            self._send(messages)

    def _name_odometry(self) -> None:
        if self._outgoing is not None and not self.frames.odom and self._odometry_frame:
            self._outgoing.odometry_frame(self._odometry_frame)

    def _is_wanted(self, kind: str) -> bool:
        return (self.record is not None and kind in RECORDED) or self.transport.is_heard(self._topics[kind])

    def _send(self, messages: list[Message]) -> None:
        for message in messages:
            topic = self._topics[message.kind]
            self.transport.publish(topic, message.content)
            if self.record is not None:
                self.record(topic.name, topic.msgtype, message.content)
