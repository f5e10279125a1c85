"""The live loop: read messages, put them in order, weigh the newest image, publish the pose."""

from __future__ import annotations

import time
from base64 import b64encode
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from localiser.camera import Camera
from localiser.errors import InputError
from localiser.filter import SURE, LocatedFrame, Start
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.live.clock import LATE_NS, RobotClock, SimulatedTime
from localiser.live.inbox import Arrival, Inbox, message_of, type_of
from localiser.live.monitor import Monitor
from localiser.live.outputs import Published, Publisher, pose_now
from localiser.live.recording import Recording
from localiser.live.requests import Requests
from localiser.live.state import Checkpoints, Resumed
from localiser.live.timeline import Frame, Timeline
from localiser.localiser import Localiser
from localiser.replay import Sink
from localiser.storage.bags import (
    DECISIONS_TOPIC,
    MAP,
    STATE_TOPIC,
    CameraFinder,
    anywhere_decision,
    clock_decision,
    floor_pose,
    grey_image,
    image_file,
    plain_frame,
    stamp_of,
    start_decision,
    start_of_message,
)

_IDLE_S = 0.05
_EXPECTED = ("image", "odometry")
_OF_ONE = ("image", "odometry", "camera_info", "groundtruth")  # whose topics have one publisher
_MOST_SENDERS = 1000
_MOST_OVERTAKING = 200  # messages that come before /clock begins anew
_REPEATED_NS = (
    2_000_000_000  # the same stated pose again so soon: a repetition, as networks and careful senders have it
)
Publish = Callable[[Published], None]


@dataclass(slots=True, eq=False)
class LiveRun:
    """A live run. publish: take every result. localiser_of: is called once the camera is known.

    publisher: sends results over the network, None where there is none. requests: answers those of services. simulated:
    the time in place of this machine's. start: given by the user, without its time; None looks for the robot
    everywhere. map_frame: the name of the map's frame. sinks: get every located image. now_ns: the clock of arrivals.
    """

    inbox: Inbox
    finder: CameraFinder
    localiser_of: Callable[[Camera], Localiser]
    monitor: Monitor
    publish: Sequence[Publish]
    recording: Recording | None = None
    start: Start | None = None
    resumed: Resumed | None = None
    checkpoints: Checkpoints | None = None
    sinks: Sequence[Sink] = ()
    publisher: Publisher | None = None
    requests: Requests | None = None
    simulated: SimulatedTime | None = None
    now_ns: Callable[[], int] = time.monotonic_ns
    localiser: Localiser | None = None
    given_map: LandmarkMap | None = None
    map_frame: str = MAP
    clock: RobotClock = field(default_factory=RobotClock)
    timeline: Timeline = field(init=False)
    _counts: Counter[str] = field(default_factory=Counter)
    _truth: deque[tuple[int, Array]] = field(default_factory=lambda: deque(maxlen=500))
    _stated: tuple[bytes, int] = (b"", 0)
    _senders: dict[str, tuple[bytes, set[bytes]]] = field(default_factory=dict)
    _overtaking: deque[tuple[Arrival, Any]] = field(default_factory=lambda: deque(maxlen=_MOST_OVERTAKING))
    _newest_odometry: tuple[int, Array] | None = None
    _intervals_s: deque[float] = field(default_factory=lambda: deque(maxlen=50))
    _costs_s: deque[float] = field(default_factory=lambda: deque(maxlen=50))

    def __post_init__(self) -> None:
        self.timeline = Timeline(self._decide, lambda frame: self.finder.mount_reaches(frame.stamp_ns))

    def run(self, ended: Callable[[], bool]) -> None:
        """Run until `ended` says so."""
        while not ended():
            self._take_all(self.inbox.take(_IDLE_S if self._is_idle() else 0.0))
            self.monitor.watch(_EXPECTED)  # now, when nothing waits that was not looked at
            self._weigh_next()

        if self.checkpoints is not None:
            self.checkpoints.close(self.localiser, self.clock.offset_ns)

    def turn(self, arrivals: Iterable[Arrival]) -> None:
        """Take in what has arrived, then weigh one image, or find the edges of one that waits for the wheels."""
        self._take_all(arrivals)
        self._weigh_next()

    def _is_idle(self) -> bool:
        waiting = self.timeline.waiting
        return waiting is None or waiting.measured is not None or self.localiser is None

    # -- in ---------------------------------------------------------------------------------------------------------

    def _take_all(self, arrivals: Iterable[Arrival]) -> None:
        """Read every message, record it if it is one, and act on it."""
        for arrival in arrivals:
            try:
                if arrival.reply is not None:
                    self._answer(arrival)
                    continue
                message = message_of(arrival)
                self._note_sender(arrival)
                if self.simulated is None or self._is_in_time(self.simulated, arrival, message):
                    self._take(self._at(arrival), message)
            except ValueError as error:
                self._warn_of_message(arrival, error)

    def _take(self, arrival: Arrival, message: Any) -> None:
        getattr(self, f"_take_{arrival.role}")(arrival, message)

    def _warn_of_message(self, arrival: Arrival, error: ValueError) -> None:
        self.monitor.warn(f"bad {arrival.role}", f"{arrival.topic}: left out a message: {error}")

    def _note_sender(self, arrival: Arrival) -> None:
        """Tell of a topic on which two publish in turn; one that takes another's place has been started again."""
        if not arrival.source or arrival.role not in _OF_ONE:
            return
        now, before = self._senders.get(arrival.role, (arrival.source, set()))
        if arrival.source in before:
            self.monitor.warn(
                f"two publishers of {arrival.role}",
                f"{arrival.topic}: expected one publisher, found two; their messages are taken as they come",
            )
        if arrival.source != now:
            before = {*before, now} if len(before) < _MOST_SENDERS else {now}
        self._senders[arrival.role] = arrival.source, before

    def _is_in_time(self, simulated: SimulatedTime, arrival: Arrival, message: Any) -> bool:
        """Whether a message is to be taken now, by the simulated time.

        Where /clock begins anew, messages of other topics may come before it, which wait for it, or after it though
        they were sent before, which are left out. Neither tells of a jump of the robot's clock.
        """
        if arrival.role in ("clock", "transforms", "moving_transforms", "camera_info"):
            return True
        if not simulated.is_known:
            self.monitor.wait("no clock", "messages wait for the simulated time on /clock")
            return False
        if arrival.role == "initialpose":
            return True
        if self.clock.is_late(stamp_of(message)):
            self._overtaking.append((self._at(arrival), message))
            return False
        return not (simulated.has_just_begun and self.clock.is_early(stamp_of(message), simulated.now_ns))

    def _at(self, arrival: Arrival) -> Arrival:
        """Return a message with the simulated time at which it came, where there is one."""
        return arrival if self.simulated is None else replace(arrival, at_ns=self.simulated.now_ns)

    def _take_clock(self, _arrival: Arrival, message: Any) -> None:
        if self.simulated is None:
            return
        clock_ns = message.clock.sec * 10**9 + message.clock.nanosec
        stamps_ns = (stamp_of(waiting) for _, waiting in self._overtaking)
        first_ns = min((ns for ns in stamps_ns if clock_ns - LATE_NS <= ns <= clock_ns), default=clock_ns)
        back_ns = self.simulated.take(clock_ns, self.clock.newest_ns + 1 - (first_ns + self.clock.offset_ns))
        if back_ns:
            self.clock.shift(back_ns)
            self._decide(clock_decision(self.clock.offset_ns))
            self.monitor.inform(f"/clock went back by {back_ns / 1e9:.1f} s: the robot begins anew")
            self._begin_anew()
        self._take_overtaking(self.simulated.now_ns, anew=back_ns > 0)

    def _take_overtaking(self, now_ns: int, *, anew: bool) -> None:
        """Take the messages that came before /clock began anew; those for which it does not do so are late."""
        while self._overtaking and (anew or now_ns - self._overtaking[0][0].at_ns > LATE_NS):
            arrival, message = self._overtaking.popleft()
            try:
                self._take(replace(arrival, at_ns=now_ns) if anew else arrival, message)
            except ValueError as error:
                self._warn_of_message(arrival, error)

    def _begin_anew(self) -> None:
        """Forget where the robot was, because its time began anew: it is where it started, or anywhere.

        A pose that was stated while driving was meant for a later time; a bag that is played again states it again.
        """
        self.finder.forget_moving()
        if self.publisher is not None:
            self.publisher.clock_jumped()
            self.publisher.forget()
        if self.localiser is None:
            return
        if self.start is not None:
            self._restart(replace(self.start, t_ns=max(self.timeline.newest_ns, self.timeline.weighed_ns) + 1))
        else:
            self.look_everywhere()

    def _answer(self, arrival: Arrival) -> None:
        if self.requests is not None:
            self.requests.answer(self, arrival)

    def _take_camera_info(self, arrival: Arrival, message: Any) -> None:
        self.finder.take_info(message)
        self._record(arrival)

    def _take_transforms(self, arrival: Arrival, message: Any) -> None:
        self.finder.take_transforms(message)
        self._record(arrival)

    def _take_moving_transforms(self, arrival: Arrival, message: Any) -> None:
        """Take transforms of the robot that change; our own, from the map, are on the same topic."""
        if all(plain_frame(each.header.frame_id) == plain_frame(self.map_frame) for each in message.transforms):
            return
        self.finder.take_moving(message)
        self._record(arrival)

    def _take_image(self, arrival: Arrival, message: Any) -> None:
        self.finder.take_image(message)
        self.monitor.heard("image")
        t_ns = self._time(arrival, message)
        number = self._record(arrival)
        if t_ns is None:
            return
        if self.finder.camera is None:
            self.monitor.wait("no camera", f"images wait for the camera: {self.finder.problem}")
            return
        self._begin(t_ns)
        frame = Frame(number, t_ns, stamp_of(message), arrival.at_ns, message)
        self.timeline.add_frame(frame)

    def _take_odometry(self, arrival: Arrival, message: Any) -> None:
        pose = np.array(floor_pose(message))
        self.finder.take_odometry(message)
        self.monitor.heard("odometry")
        t_ns = self._time(arrival, message)
        number = self._record(arrival)
        if t_ns is None:
            self.timeline.leave_out(stamp_of(message), number, "stamp cannot be true")
            return
        if self._newest_odometry is not None:
            self._intervals_s.append((t_ns - self._newest_odometry[0]) / 1e9)
        self.timeline.add_odometry(t_ns, number, pose, arrival.at_ns)
        if self._newest_odometry is None or t_ns > self._newest_odometry[0]:
            self._newest_odometry = t_ns, pose
            if self.publisher is not None:
                self.publisher.wheels(t_ns - self.clock.offset_ns, plain_frame(message.header.frame_id))

    def _take_groundtruth(self, arrival: Arrival, message: Any) -> None:
        pose = np.array(floor_pose(message))
        t_ns = self.clock.possible_time(stamp_of(message), arrival.at_ns)
        if t_ns is None:
            if self.clock.is_known:
                self._warn_of_stamp(arrival, stamp_of(message))
        elif not self._truth or t_ns > self._truth[-1][0]:
            self._truth.append((t_ns, pose))
            self._record(arrival)

    def _take_initialpose(self, arrival: Arrival, message: Any) -> None:
        before, before_ns = self._stated
        if arrival.content == before and arrival.at_ns - before_ns < _REPEATED_NS:
            self._stated = before, arrival.at_ns
            return
        self._check_frame(arrival, message)
        mean, cov = start_of_message(message)
        self._stated = arrival.content, arrival.at_ns
        self._record(arrival)
        if self.localiser is None:
            self.start, self.resumed = Start(0, mean, cov), None
        else:
            newest_ns = max(self.timeline.newest_ns, self.timeline.weighed_ns)
            t_ns = stamp_of(message) + self.clock.offset_ns
            # Whoever states a pose may have another clock; then it is meant for now.
            self._restart(Start(t_ns if newest_ns - LATE_NS <= t_ns <= newest_ns else newest_ns, mean, cov))

    def _check_frame(self, arrival: Arrival, message: Any) -> None:
        """Raise ValueError unless a pose is in the map's frame; one that names no frame is taken to be."""
        frame, expected = plain_frame(message.header.frame_id), plain_frame(self.map_frame)
        if not frame:
            self.monitor.warn("pose without a frame", f"{arrival.topic}: a pose names no frame; taken to be {expected}")
        elif frame != expected:
            raise ValueError(f"expected a pose in the frame {expected}, found one in {frame}")

    def _time(self, arrival: Arrival, message: Any) -> int | None:
        """Return the time of a message by its stamp, None when that cannot be true."""
        jumps = self.clock.jumps
        stamp_ns = stamp_of(message)
        t_ns = self.clock.time_of(stamp_ns, arrival.at_ns)
        if t_ns is None:
            self._warn_of_stamp(arrival, stamp_ns)
        if self.clock.jumps > jumps:
            self.monitor.warn("clock jumps", "the robot's clock has jumped; going on from where it was")
            self._decide(clock_decision(self.clock.offset_ns))
            self.finder.forget_moving()
            if self.publisher is not None:
                self.publisher.clock_jumped()
        return t_ns

    def _warn_of_stamp(self, arrival: Arrival, stamp_ns: int) -> None:
        self.monitor.warn(
            "wrong stamps",
            f"{arrival.topic}: left out a message with the stamp {stamp_ns} ns, which cannot be true now; do camera, "
            "wheels and truth share a clock?",
        )

    def _record(self, arrival: Arrival) -> int:
        """Record a message that can be read; return how many of its role were recorded before."""
        number = self._counts[arrival.role]
        self._counts[arrival.role] += 1
        if self.recording is not None:
            msgtype = type_of(arrival.role, arrival.topic)
            self.recording.write(arrival.topic, msgtype, arrival.wall_ns, arrival.content)
        return number

    def _decide(self, decision: str) -> None:
        self._tell(DECISIONS_TOPIC, decision)

    def _tell(self, topic: str, text: str) -> None:
        """Record what no message says."""
        if self.recording is not None:
            self.recording.tell(topic, text)

    # -- the localiser ------------------------------------------------------------------------------------------------

    def _begin(self, t_ns: int) -> None:
        """Make the localiser with the first image since the camera is known, and start it if it is known where."""
        if self.localiser is not None or self.finder.camera is None:
            return
        self.localiser = self.localiser_of(self.finder.camera)
        if self.given_map is not None:
            self.localiser = Localiser(self.given_map, self.finder.camera, self.localiser.config)
        self.timeline.needs_wheels = self.localiser.needs_wheels
        self.monitor.inform("the camera is known")
        if self.publisher is not None:
            self.publisher.begin(self.localiser.landmark_map, self.finder.camera, t_ns - self.clock.offset_ns)
        if self.resumed is not None:
            self._decide(start_decision(self.resumed.begin(self.localiser, self.timeline, t_ns)))
            self._tell(STATE_TOPIC, b64encode(self.resumed.content).decode())
            self.monitor.inform(self.resumed.text)
        elif self.start is not None:
            self._restart(replace(self.start, t_ns=t_ns))
        else:
            self._decide(anywhere_decision())
            self.monitor.inform("no start is known: the robot is looked for on the whole map")

    def _restart(self, start: Start) -> None:
        assert self.localiser is not None
        begun = replace(start, t_ns=self.timeline.restart(start.t_ns))
        self.localiser.start(begun.mean, begun.cov, begun.t_ns)
        self._decide(start_decision(begun))
        x, z, heading = begun.mean
        self.monitor.inform(f"started at x = {x:.2f} m, z = {z:.2f} m, heading = {np.rad2deg(heading):.1f}°")

    # -- what others may ask for --------------------------------------------------------------------------------------

    def look_everywhere(self) -> None:
        """Forget where the robot is, and look for it on the whole map from the next image on."""
        self.start, self.resumed = None, None
        if self.localiser is None:
            return
        if not self.localiser.can_look_everywhere:
            self.monitor.warn("no global localisation", "these settings cannot look for the robot on the whole map")
            return
        t_ns = self.timeline.restart(max(self.timeline.newest_ns, self.timeline.weighed_ns))
        self.localiser.look_everywhere(t_ns)
        if self.publisher is not None:
            self.publisher.forget()
        self._decide(anywhere_decision(t_ns))
        self.monitor.inform("the robot is looked for on the whole map")

    def load_map(self, landmark_map: LandmarkMap, path: Path) -> None:
        """Go on with another map: the robot took the lift. What was believed is forgotten. Raises InputError.

        A recording belongs to one map and ends here. A state that is saved from here on belongs to the new map.
        path: of the map, so that a state that is resumed finds it again.
        """
        if self.checkpoints is not None:
            self.checkpoints.now_on(path)
        if self.localiser is None or self.finder.camera is None:
            self.given_map, self.start, self.resumed = landmark_map, None, None
            return
        before = self.localiser
        self.localiser = Localiser(landmark_map, self.finder.camera, before.config)
        self.start, self.resumed = None, None
        if self.recording is not None:
            self.recording.close()
            self.recording = None
            self.monitor.warn("recording ended", "the recording ended, because it belongs to the map before")
        self.timeline.restart(self.clock.newest_ns + 1)  # what was seen before belongs to the map before
        for pose in before.state.odometry:
            self.localiser.odometry(pose.t_ns, pose.pose)
        if self.publisher is not None:
            self.publisher.record = None
            self.publisher.begin(landmark_map, self.finder.camera, self.timeline.weighed_ns - self.clock.offset_ns)
        name = landmark_map.name or "another one"
        self.monitor.inform(f"the map is now {name}; the robot is looked for on the whole of it")

    def _weigh_next(self) -> None:
        """Weigh one image, or find the edges of one that waits for the wheels."""
        if self.localiser is None:
            return
        frame = self.timeline.next(self._affordable(), self._now_ns())
        if frame is not None:
            self._weigh(self.localiser, frame)
            return
        waiting = self.timeline.waiting
        if waiting is None or waiting.measured is not None or self.localiser.camera.shutter is not None:
            return
        if self.finder.mount_reaches(waiting.stamp_ns):
            self._find_edges(self.localiser, waiting)

    def _now_ns(self) -> int:
        return self.now_ns() if self.simulated is None else self.simulated.now_ns

    def _latency_ms(self, stamp_ns: int) -> float:
        """Return how long ago a stamp was: by the simulated time, else by this machine's calendar."""
        now_ns = time.time_ns() if self.simulated is None else self.simulated.clock_ns
        return (now_ns - stamp_ns) / 1e6

    def _affordable(self) -> int:
        """Return how many images there is time for until the wheels report again."""
        if len(self._costs_s) < 5 or len(self._intervals_s) < 5:
            return 1
        return int(median(self._intervals_s) / median(self._costs_s))

    def _find_edges(self, localiser: Localiser, frame: Frame) -> None:
        """Find the edges of an image; an image that is damaged is left out."""
        try:
            pixels = grey_image(frame.message)
            image = image_file(frame.message) if pixels is None else pixels
            mount, twist = self.finder.mount_at(frame.stamp_ns), localiser.twist_at(frame.t_ns, self.timeline.track)
            frame.measured = localiser.measure(image, mount, twist)
        except (InputError, ValueError) as error:
            self.monitor.warn("bad image", f"left out an image: {error}")
            self.timeline.discard(frame, "damaged")

    def _weigh(self, localiser: Localiser, frame: Frame) -> None:
        begin = time.perf_counter()
        if frame.measured is None:
            self._find_edges(localiser, frame)
        if frame.measured is None:
            return
        for pose in self.timeline.release(frame):
            localiser.odometry(pose.t_ns, pose.pose)
        (found,) = localiser.edges(frame.t_ns, frame.measured, by_wheels=frame.by_wheels)
        found = replace(found, truth=self._true_pose(frame.t_ns))
        self._hand_out(frame, found)
        for sink in self.sinks:
            sink.frame(found)
        self._costs_s.append(time.perf_counter() - begin)
        if self.checkpoints is not None:
            self.checkpoints.save_if_due(localiser, self.clock.offset_ns)

    def _hand_out(self, frame: Frame, found: LocatedFrame) -> None:
        located, truth = found.located, found.truth
        now_ns, odometry_now = self._newest_odometry or (frame.t_ns, located.odometry)
        if now_ns < frame.t_ns:
            now_ns, odometry_now = frame.t_ns, located.odometry
        published = Published(
            located,
            frame.stamp_ns,
            now_ns - self.clock.offset_ns,
            pose_now(located, odometry_now),
            self._newest_odometry is not None,
            self._latency_ms(frame.stamp_ns),
            None if truth is None else float(np.hypot(*(located.estimate.pose - truth)[:2])),
        )
        if self.publisher is not None:
            camera_frame = plain_frame(frame.message.header.frame_id)
            self.publisher.image(found, frame.stamp_ns, self._facts(published.latency_ms), camera_frame)
        for publish in self.publish:
            publish(published)
        work_ms = found.stage_ms["edges"] + found.stage_ms["filter"]
        if self.localiser is not None and found.located.p_correct > SURE:
            stated_m = self.localiser.camera.at(found.located.edges.mount).mount.height_m
            if off := found.located.height.warning(stated_m):
                self.monitor.warn("height", off)
        self.monitor.located(found, published.latency_ms, work_ms, published.error_m)

    def _facts(self, latency_ms: float) -> dict[str, str]:
        """Return what diagnostics tell besides the image: how the run goes, and what was wrong how often."""
        facts = {"latency_ms": f"{latency_ms:.1f}", "rate_hz": f"{self.monitor.rate_now_hz:.2f}"}
        return facts | {f"warnings, {kind}": str(count) for kind, count in self.monitor.wrong.items()}

    def _true_pose(self, t_ns: int) -> Array | None:
        if len(self._truth) < 2 or not self._truth[0][0] <= t_ns <= self._truth[-1][0]:
            return None
        times, poses = zip(*self._truth, strict=True)
        return Trajectory(np.array(times), np.array(poses)).at(t_ns)
