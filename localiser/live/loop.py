"""The live loop: read messages, check their times, and hand them to what tracks the robot, between two images."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from localiser.errors import InputError
from localiser.filter import Start
from localiser.geometry import Array
from localiser.live.clock import LATE_NS, Clocks, SimulatedTime
from localiser.live.inbox import Arrival, Inbox, message_of
from localiser.live.outputs import Outputs
from localiser.live.timeline import WaitingImage
from localiser.live.tracker import Tracker
from localiser.ros import MAP_INVALID, MAP_LOADED, MAP_NOT_THERE, map_frames, service_bytes, service_message
from localiser.storage import read_map
from localiser.storage.bags import MAP, clock_decision, floor_pose, plain_frame, stamp_of, start_of_message

_IDLE_S = 0.05
_EXPECTED = ("image", "odometry")
_OF_ONE = ("image", "odometry", "camera_info", "groundtruth")  # whose topics have one publisher
_MOST_SENDERS = 1000
_REPEATED_NS = 2_000_000_000  # the same pose stated again so soon is a repetition, as careful senders have it


@dataclass(slots=True, eq=False)
class LiveRun:
    """A live run. maps: the folder from which maps may be loaded on request. map_frame: the name of the map's frame."""

    inbox: Inbox
    tracker: Tracker
    clocks: Clocks
    outputs: Outputs
    maps: Path
    map_frame: str = MAP
    _stated: tuple[bytes, int] = (b"", 0)
    _senders: dict[str, tuple[bytes, set[bytes]]] = field(default_factory=dict)

    def run(self, ended: Callable[[], bool]) -> None:
        """Run until `ended` says so."""
        while not ended():
            self.turn(self.inbox.take(_IDLE_S if self.tracker.is_idle else 0.0))
            self.outputs.monitor.watch(_EXPECTED)
        self.tracker.close()

    def turn(self, arrivals: Iterable[Arrival]) -> None:
        """Take in what has arrived, then weigh one image, or find the edges of one that waits for the wheels."""
        self._take_all(arrivals)
        self.tracker.weigh_next()

    def _take_all(self, arrivals: Iterable[Arrival]) -> None:
        """Read every message, record it if it is one, and act on it."""
        for arrival in arrivals:
            try:
                if arrival.reply is not None:
                    arrival.reply(self._answer(arrival))
                    continue
                message = message_of(arrival)
                self._note_sender(arrival)
                if self.clocks.simulated is None:
                    self._take(arrival, message)
                elif self._is_in_time(self.clocks.simulated, arrival, message):
                    self._take(replace(arrival, at_ns=self.clocks.now_ns), message)
            except ValueError as error:
                self.outputs.monitor.warn(f"bad {arrival.role}", f"{arrival.topic}: left out a message: {error}")

    def _take(self, arrival: Arrival, message: Any) -> None:
        finder = self.tracker.finder
        if take := {"camera_info": finder.take_info, "transforms": finder.take_transforms}.get(arrival.role):
            take(message)
            self.outputs.record(arrival)
        else:
            getattr(self, f"_take_{arrival.role}")(arrival, message)

    def _note_sender(self, arrival: Arrival) -> None:
        """Tell of a topic on which two publish in turn; one that takes another's place has been started again."""
        if not arrival.source or arrival.role not in _OF_ONE:
            return
        now, before = self._senders.get(arrival.role, (arrival.source, set()))
        if arrival.source in before:
            self.outputs.monitor.warn(
                f"two publishers of {arrival.role}",
                f"{arrival.topic}: expected one publisher, found two; their messages are taken as they come",
            )
        if arrival.source != now:
            before = {*before, now} if len(before) < _MOST_SENDERS else {now}
        self._senders[arrival.role] = arrival.source, before

    # -- requests -----------------------------------------------------------------------------------------------------

    def _answer(self, arrival: Arrival) -> bytes:
        """Do what a request of a service asks for, and return the answer. Raises ValueError when it is none."""
        request, fields = service_message(arrival.role, "Request", arrival.content), {}
        if arrival.role == "load_map":
            fields["result"] = self._load_map(str(request.map_url))
        else:
            self.tracker.look_everywhere()
        return service_bytes(arrival.role, "Response", **fields)

    def _load_map(self, asked: str) -> int:
        """Load a map that is in the folder of maps; a path that leads elsewhere is refused."""
        path, monitor, is_there = self.maps / asked.removeprefix("file://"), self.outputs.monitor, False
        with suppress(OSError, RuntimeError, ValueError):  # a name that is too long, a loop of links, a NUL
            is_there = path.resolve().is_relative_to(self.maps.resolve()) and path.is_file()
        if not is_there:
            monitor.warn("no such map", f"expected a map in {self.maps}, asked for {asked!r}")
            return MAP_NOT_THERE
        try:
            self.tracker.load_map(read_map(path))
        except InputError as error:
            monitor.warn("bad map", f"the map stays as it was: {error}")
            return MAP_INVALID
        return MAP_LOADED

    # -- times --------------------------------------------------------------------------------------------------------

    def _is_in_time(self, simulated: SimulatedTime, arrival: Arrival, message: Any) -> bool:
        """Whether a message is to be taken now, by the simulated time.

        Where /clock begins anew, messages of other topics may come before it, or after it though they were sent before.
        Both are left out, so that neither tells of a jump of the robot's clock.
        """
        if arrival.role in ("clock", "transforms", "moving_transforms", "camera_info"):
            return True
        if not simulated.is_known:
            self.outputs.monitor.wait("no clock", "messages wait for the simulated time on /clock")
            return False
        if arrival.role == "initialpose":
            return True
        robot, stamp_ns = self.clocks.robot, stamp_of(message)
        early = simulated.has_just_begun and robot.is_early(stamp_ns, simulated.now_ns)
        return not (early or robot.is_late(stamp_ns))

    def _take_clock(self, _arrival: Arrival, message: Any) -> None:
        simulated, robot = self.clocks.simulated, self.clocks.robot
        if simulated is None:
            return
        clock_ns = message.clock.sec * 10**9 + message.clock.nanosec
        back_ns = simulated.take(clock_ns, robot.newest_ns + 1 - (clock_ns + robot.offset_ns))
        if back_ns:
            robot.shift(back_ns)
            self.outputs.decide(clock_decision(robot.offset_ns))
            self.outputs.monitor.inform(f"/clock went back by {back_ns / 1e9:.1f} s: the robot begins anew")
            self.tracker.begin_anew()

    def _time(self, arrival: Arrival, message: Any) -> int | None:
        """Return the time of a message by its stamp, None when that cannot be true."""
        robot, stamp_ns = self.clocks.robot, stamp_of(message)
        jumps = robot.jumps
        t_ns = robot.time_of(stamp_ns, arrival.at_ns)
        if t_ns is None:
            self._warn_of_stamp(arrival, stamp_ns)
        if robot.jumps > jumps:
            self.outputs.monitor.warn("clock jumps", "the robot's clock has jumped; going on from where it was")
            self.outputs.decide(clock_decision(robot.offset_ns))
            self.tracker.finder.forget_moving()
            self.outputs.publisher.clock_jumped()
        return t_ns

    def _warn_of_stamp(self, arrival: Arrival, stamp_ns: int) -> None:
        self.outputs.monitor.warn(
            "wrong stamps",
            f"{arrival.topic}: left out a message with the stamp {stamp_ns} ns, which cannot be true now; do camera, "
            "wheels and truth share a clock?",
        )

    # -- messages by their roles --------------------------------------------------------------------------------------

    def _take_moving_transforms(self, arrival: Arrival, message: Any) -> None:
        """Take transforms of the robot that change; our own, from the map, are on the same topic."""
        if all(plain_frame(each.header.frame_id) in self._map_names for each in message.transforms):
            return
        self.tracker.finder.take_moving(message)
        self.outputs.record(arrival)

    def _take_image(self, arrival: Arrival, message: Any) -> None:
        finder = self.tracker.finder
        finder.take_image(message)
        self.outputs.monitor.heard("image")
        t_ns = self._time(arrival, message)
        number = self.outputs.record(arrival)
        if t_ns is None:
            return
        if finder.camera is None:
            self.outputs.monitor.wait("no camera", f"images wait for the camera: {finder.problem}")
            return
        self.tracker.add_frame(WaitingImage(number, t_ns, stamp_of(message), arrival.at_ns, message))

    def _take_odometry(self, arrival: Arrival, message: Any) -> None:
        pose = np.array(floor_pose(message))
        self.tracker.finder.take_odometry(message)
        self.outputs.monitor.heard("odometry")
        t_ns = self._time(arrival, message)
        number = self.outputs.record(arrival)
        if t_ns is None:
            self.tracker.timeline.leave_out(stamp_of(message), number, "stamp cannot be true")
        elif self.tracker.add_odometry(t_ns, number, pose, arrival.at_ns):
            self.outputs.publisher.wheels(self.clocks.stamp_of(t_ns), plain_frame(message.header.frame_id))

    def _take_groundtruth(self, arrival: Arrival, message: Any) -> None:
        pose, robot = np.array(floor_pose(message)), self.clocks.robot
        t_ns = robot.possible_time(stamp_of(message), arrival.at_ns)
        if t_ns is None:
            if robot.is_known:
                self._warn_of_stamp(arrival, stamp_of(message))
        elif self.tracker.add_truth(t_ns, pose):
            self.outputs.record(arrival)

    def _take_initialpose(self, arrival: Arrival, message: Any) -> None:
        before, before_ns = self._stated
        if arrival.content == before and arrival.at_ns - before_ns < _REPEATED_NS:
            self._stated = before, arrival.at_ns
            return
        origin = self._origin_of_frame(arrival, message)
        mean, cov = start_of_message(message)
        mean = mean + origin
        self._stated = arrival.content, arrival.at_ns
        self.outputs.record(arrival)
        newest_ns = self.tracker.newest_ns
        t_ns = stamp_of(message) + self.clocks.robot.offset_ns
        # Whoever states a pose may have another clock; then it is meant for now.
        self.tracker.state_pose(Start(t_ns if newest_ns - LATE_NS <= t_ns <= newest_ns else newest_ns, mean, cov))

    @property
    def _map_names(self) -> dict[str, str]:
        """The name of each map by that of its frame."""
        return map_frames(plain_frame(self.map_frame), self.tracker.landmark_map)

    def _origin_of_frame(self, arrival: Arrival, message: Any) -> Array:
        """Return where (3,) the frame of a pose lies; one that names no frame is in that of the (first) map.

        Raises ValueError unless it is a map's.
        """
        frame, names = plain_frame(message.header.frame_id), self._map_names
        if not frame:
            text = f"{arrival.topic}: a pose names no frame; taken to be {next(iter(names))}"
            self.outputs.monitor.warn("pose without a frame", text)
        elif frame not in names:
            raise ValueError(f"expected a pose in the frame {' or '.join(names)}, found one in {frame}")
        return self.tracker.landmark_map.origin(names.get(frame, ""))
