"""A simulated robot: sends a log over the network in real time, forwards and backwards, without end."""

from __future__ import annotations

import heapq
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count
from threading import Event

import numpy as np

from localiser.errors import InputError
from localiser.geometry import Trajectory
from localiser.live.transport import Transport
from localiser.ros import Topic
from localiser.storage import ImageEvent, Log, require_odometry
from localiser.storage.bags import MAP, ODOM, Messages, RosType

IMAGE = Topic("/camera/image_raw/compressed", RosType.COMPRESSED, depth=5)
INFO = Topic("/camera/camera_info", RosType.CAMERA_INFO)
WHEELS, TRUTH = Topic("/odom", RosType.ODOMETRY), Topic("/ground_truth/odom", RosType.ODOMETRY)
FIXED = Topic("/tf_static", RosType.TRANSFORMS, latched=True, depth=1)
MOVING = Topic("/tf", RosType.TRANSFORMS, depth=100)
ODOMETRY_HZ = 100.0  # to which a log's odometry is interpolated
_FORGIVEN_S = 1.0  # what a robot that was held up sends late; older messages it has lost
_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """One way through a log. begin_ns, length_ns: of its odometry. wheels: that, as it is sent."""

    log: Log
    begin_ns: int
    length_ns: int
    wheels: Trajectory

    @classmethod
    def of(cls, log: Log) -> Passage:
        """Return the whole log. Raises InputError."""
        if not log.has_images:
            raise InputError("expected a log with images, found edges", path=log.path)
        require_odometry(log, "a stand-in robot")
        first, last = int(log.odometry.t_ns[0]), int(log.odometry.t_ns[-1])
        steps = int((last - first) * ODOMETRY_HZ / _NS)
        times = first + np.round(np.arange(steps + 1) * (_NS / ODOMETRY_HZ)).astype(np.int64)
        return cls(log, first, last - first, log.odometry.sampled(times))

    def messages(self, there: bool) -> Iterator[tuple[int, Topic, int]]:
        """Yield (time since the begin of this way, topic, index) in the order of time; back, everything is mirrored."""
        end_ns = self.begin_ns + self.length_ns
        images = [(frame.t_ns, IMAGE, k) for k, frame in enumerate(self.log.frames)]
        images = [image for image in images if self.begin_ns <= image[0] <= end_ns]
        wheels = [(int(t_ns), WHEELS, k) for k, t_ns in enumerate(self.wheels.t_ns)]
        if there:
            both = heapq.merge(images, wheels, key=lambda message: message[0])
            yield from ((t_ns - self.begin_ns, topic, k) for t_ns, topic, k in both)
        else:  # where it turns, the robot has just been
            back = heapq.merge(wheels[-2::-1], images[::-1], key=lambda message: -message[0])
            yield from ((end_ns - t_ns, topic, k) for t_ns, topic, k in back if self.begin_ns < t_ns < end_ns)


class StandIn:
    """Publishes a passage there and back, for ever."""

    def __init__(self, transport: Transport, passage: Passage, prefix: str = "") -> None:
        """Be ready; the fixed transforms are sent now and kept for those who come later, as robots do.

        prefix: of all topics, such as `/robot1`.
        """
        self._transport, self._passage, self._make = transport, passage, Messages()
        self._named = {
            topic: replace(topic, name=f"{prefix}{topic.name}") for topic in (IMAGE, INFO, WHEELS, TRUTH, FIXED, MOVING)
        }
        for topic in self._named:
            transport.advertise(self._named[topic])
        if not passage.log.mount_moves:
            self._publish(FIXED, self._make.encode(self._make.mount(time.time_ns(), passage.log.camera)))

    def wait_for_listener(self, stop: Event) -> None:
        """Stand still until someone wants images."""
        while not self._transport.is_heard(self._named[IMAGE]):
            if stop.wait(0.1):
                return

    def run(self, stop: Event, ways: int | None = None) -> None:
        """Publish until `stop` is set, or for a number of ways."""
        begin_ns, begin_s = time.time_ns(), time.monotonic()
        for way in count() if ways is None else range(ways):
            offset_ns = way * self._passage.length_ns
            for t_ns, topic, index in self._passage.messages(there=way % 2 == 0):
                due_ns = offset_ns + t_ns
                late_s = time.monotonic() - begin_s - due_ns / 1e9
                if late_s > _FORGIVEN_S:
                    continue
                if stop.wait(-late_s) if late_s < 0 else stop.is_set():
                    return
                self._send(topic, begin_ns + due_ns, index)

    def _send(self, topic: Topic, stamp_ns: int, index: int) -> None:
        make, log = self._make, self._passage.log
        if topic == IMAGE:
            frame = log.frames[index]
            assert isinstance(frame, ImageEvent)
            if frame.mount is not None:
                self._publish(MOVING, make.encode(make.mount(stamp_ns, log.camera.at(frame.mount))))
            self._publish(INFO, make.encode(make.camera_info(stamp_ns, log.camera)))
            self._publish(IMAGE, make.encode(make.compressed(stamp_ns, frame.encoded())))
        else:
            wheels, truth = self._passage.wheels, log.groundtruth
            if truth is not None:  # before the wheels' pose, at which an image is weighed and compared with the truth
                true_pose = truth.at(int(wheels.t_ns[index]))
                self._publish(TRUTH, make.encode(make.odometry(stamp_ns, MAP, true_pose)))
            self._publish(WHEELS, make.encode(make.odometry(stamp_ns, ODOM, wheels.poses[index])))

    def _publish(self, topic: Topic, content: bytes) -> None:
        self._transport.publish(self._named[topic], content)
