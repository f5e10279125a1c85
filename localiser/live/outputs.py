"""What goes out of a live run: lines of JSON, what is published on the network, and the recording."""

from __future__ import annotations

import json
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from queue import Empty, Queue
from threading import Condition, Thread

import numpy as np

from localiser.camera import Camera
from localiser.documents import write_all
from localiser.errors import OutputError
from localiser.filter import SURE, Located, LocatedFrame
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.live.inbox import Arrival, type_of
from localiser.live.monitor import Monitor
from localiser.live.transport import Transport
from localiser.replay import Sink
from localiser.ros import Frames, Message, Outgoing, Topic
from localiser.storage.bags import DECISIONS_TOPIC, BagRecorder, Messages, RosType

MOST_LINES = 1000
RADIUS_95 = 2.4477  # sigmas of a position in two directions


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """One image's result as it goes out. stamp_ns, now_ns: of the image and of the wheels' last pose, by the robot.

    now: (3,) pose in the map then. latency_ms: from the image's stamp, by this machine's calendar. map_name: of several
    maps the one that poses are on. error_m: where the robot tells the truth beside.
    """

    located: Located
    stamp_ns: int
    now_ns: int
    now: Array
    latency_ms: float
    map_name: str = ""
    error_m: float | None = None

    def line(self) -> str:
        """Return the line of JSON."""
        located, estimate = self.located, self.located.estimate
        x, z, heading = estimate.pose.tolist()
        now_x, now_z, now_heading = self.now.tolist()
        data = {
            "stamp_ns": self.stamp_ns,
            "t_ns": located.t_ns,
            "x": x,
            "z": z,
            "heading": heading,
            "cov": estimate.pose_cov[np.triu_indices(3)].tolist(),
            "now": {"stamp_ns": self.now_ns, "x": now_x, "z": now_z, "heading": now_heading},
            "edges": len(located.edges),
            "p_correct": round(float(located.p_correct), 4),
            "latency_ms": round(self.latency_ms, 3),
            # As VDA 5050 has them; 95 % of the positions are within the range.
            "localized": bool(located.p_correct > SURE),
            "localizationScore": round(float(located.p_correct), 4),
            "deviationRange": round(float(RADIUS_95 * np.sqrt(np.linalg.eigvalsh(estimate.pose_cov[:2, :2])[1])), 4),
        } | ({"map": self.map_name} if self.map_name else {})
        return json.dumps(data | ({} if self.error_m is None else {"error_m": round(self.error_m, 6)}))


class JsonLines:
    """Writes lines to a file descriptor on a thread of its own; of a reader that is too slow the oldest are dropped."""

    def __init__(self, descriptor: int) -> None:
        """Begin."""
        self._descriptor = descriptor
        self._queue: Queue[str | None] = Queue(MOST_LINES)
        self._thread = Thread(target=self._work, name="json", daemon=True)
        self._thread.start()

    def put(self, line: str | None) -> None:
        """Write a line; None ends the thread."""
        with suppress(Empty):
            if self._queue.full():
                self._queue.get_nowait()
        self._queue.put(line)

    def close(self) -> None:
        """End; waits a moment for a slow reader."""
        self.put(None)
        self._thread.join(1.0)

    def _work(self) -> None:
        with suppress(OSError):  # nobody reads any more
            while (line := self._queue.get()) is not None:
                write_all(partial(os.write, self._descriptor), f"{line}\n".encode())


RECORDED = frozenset(("tf", "diagnostics", "places"))
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
    outputs: Mapping[str, Topic]
    frames: Frames = field(default_factory=lambda: Frames(odom=""))
    tolerance_ns: int = 200_000_000
    record: Record | None = None
    _outgoing: Outgoing | None = None
    _newest_ns: int = -1
    _followed_ns: int = -1
    _odometry_frame: str = ""

    def __post_init__(self) -> None:
        for topic in self.outputs.values():
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
        if frame:
            self._outgoing.frames = replace(self._outgoing.frames, camera=frame)
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
            self._outgoing.frames = replace(self._outgoing.frames, odom=self._odometry_frame)

    def _is_wanted(self, kind: str) -> bool:
        return (self.record is not None and kind in RECORDED) or self.transport.is_heard(self.outputs[kind])

    def _send(self, messages: list[Message]) -> None:
        for message in messages:
            topic = self.outputs[message.kind]
            self.transport.publish(topic, message.content)
            if self.record is not None:
                self.record(topic.name, topic.msgtype, message.content)


# -- the recording ----------------------------------------------------------------------------------------------------

COMMIT_S = 0.5
MOST_BYTES = 256 * 2**20
"""What may wait for the disk."""

CLOSE_WAIT_S = 10.0

_Row = tuple[str, str, int, bytes]


class Recording:
    """A bag of what came in and what was decided; written in the order of the calls."""

    def __init__(self, path: Path, failed: Callable[[str], None], latched: Collection[str] = ()) -> None:
        """Make the bag. latched: see `BagRecorder`. failed: takes the reason why the recording ended, in a thread.

        Raises InputError, OutputError.
        """
        self._recorder = BagRecorder(path, latched)
        self._failed, self._messages = failed, Messages()
        self._queue: deque[_Row] = deque()
        self._bytes = 0
        self._changed = Condition()
        self._is_open = True
        self._thread = Thread(target=self._work, name="recording", daemon=True)
        self._thread.start()

    def write(self, topic: str, msgtype: str, t_ns: int, content: bytes) -> None:
        """Record a message that came at `t_ns`, by the calendar; never waits."""
        with self._changed:
            if not self._is_open:
                return
            self._queue.append((topic, msgtype, t_ns, content))
            self._bytes += len(content)
            self._changed.notify()

    def send(self, topic: str, msgtype: str, content: bytes) -> None:
        """Record a message that goes out now; never waits."""
        self.write(topic, msgtype, time.time_ns(), content)

    def tell(self, topic: str, text: str) -> None:
        """Record what no message says."""
        self.send(topic, RosType.TEXT, self._messages.encode(self._messages.text(text)))

    def close(self) -> None:
        """Write what waits, and end."""
        with self._changed:
            self._is_open = False
            self._changed.notify()
        self._thread.join(CLOSE_WAIT_S)

    def _work(self) -> None:
        try:
            while self._write_waiting():
                pass
            self._recorder.close()
        except OutputError as error:
            self._end(str(error))

    def _write_waiting(self) -> bool:
        """Write and commit what has come; return whether there will be more."""
        due = time.monotonic() + COMMIT_S
        going_on = True
        while going_on and (left_s := due - time.monotonic()) > 0:
            with self._changed:
                self._changed.wait_for(lambda: self._queue or not self._is_open, left_s)
                rows, going_on = list(self._queue), self._is_open
                too_much, self._bytes = self._bytes > MOST_BYTES, 0
                self._queue.clear()
            if too_much:
                raise OutputError("the disk is too slow for what comes in")
            for row in rows:
                self._recorder.write(*row)
        self._recorder.commit()
        return going_on

    def _end(self, why: str) -> None:
        with self._changed:
            self._is_open = False
            self._queue.clear()
        with suppress(OutputError):  # the disk is still full; what was committed stays
            self._recorder.close()
        self._failed(f"The recording ended, the run goes on: {why}")


@dataclass(slots=True, eq=False)
class Outputs:
    """All that a live run tells: its user, the network, the recording, lines of JSON, views.

    recording: None where nothing is recorded. publish: take every result. sinks: get every located image.
    """

    monitor: Monitor
    publisher: Publisher
    recording: Recording | None = None
    publish: Sequence[Callable[[Published], None]] = ()
    sinks: Sequence[Sink] = ()
    _counts: Counter[str] = field(default_factory=Counter)

    def record(self, arrival: Arrival) -> int:
        """Record a message that can be read; return how many of its role were recorded before."""
        number = self._counts[arrival.role]
        self._counts[arrival.role] += 1
        if self.recording is not None:
            msgtype = type_of(arrival.role, arrival.topic)
            self.recording.write(arrival.topic, msgtype, arrival.wall_ns, arrival.content)
        return number

    def decide(self, decision: str) -> None:
        """Record a decision, which a replay takes too."""
        self.tell(DECISIONS_TOPIC, decision)

    def tell(self, topic: str, text: str) -> None:
        """Record what no message says."""
        if self.recording is not None:
            self.recording.tell(topic, text)

    def end_recording(self, why: str) -> None:
        """End the recording, if there is one, and say why."""
        if self.recording is not None:
            self.recording.close()
            self.recording = None
            self.monitor.warn("recording ended", f"the recording ended, {why}")
        self.publisher.record = None

    def located(self, found: LocatedFrame, published: Published, camera_frame: str) -> None:
        """Tell what was located in an image. camera_frame: as the image names it."""
        facts = {"latency_ms": f"{published.latency_ms:.1f}", "rate_hz": f"{self.monitor.rate_now_hz:.2f}"}
        facts |= {f"warnings, {kind}": str(count) for kind, count in self.monitor.wrong.items()}
        self.publisher.image(found, published.stamp_ns, facts, camera_frame)
        for publish in self.publish:
            publish(published)
        work_ms = found.stage_ms["edges"] + found.stage_ms["filter"]
        self.monitor.located(found, published.latency_ms, work_ms, published.error_m)
        for sink in self.sinks:
            sink.frame(found)
