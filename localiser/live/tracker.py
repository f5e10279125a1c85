"""The localiser of a live run: where it starts, which image is weighed next, and what is known after that."""

from __future__ import annotations

import time
from base64 import b64encode
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from threading import Thread

import numpy as np

from localiser.camera import Camera
from localiser.documents import read_bytes
from localiser.errors import InputError, OutputError
from localiser.filter import SURE, LocatedFrame, Start
from localiser.geometry import Array, Trajectory, between, compose
from localiser.landmarks import LandmarkMap
from localiser.live.clock import Clocks
from localiser.live.outputs import Outputs, Published
from localiser.live.timeline import Timeline, WaitingImage, is_driven
from localiser.localiser import Localiser
from localiser.storage import checkpoint_of, identity_of, write_bytes
from localiser.storage.bags import (
    STATE_TOPIC,
    CameraFinder,
    anywhere_decision,
    grey_image,
    image_file,
    plain_frame,
    start_decision,
)

# -- the state, saved every few seconds, so that a restarted program is not lost -------------------------------------

EVERY_S = 3.0
MAX_BYTES = 2**30  # a state of ten million particles with five constant errors


@dataclass(slots=True, eq=False)
class Checkpoints:
    """Saves the state of a run, on a thread, because disks take their time. failed: takes what went wrong."""

    path: Path
    failed: Callable[[str], None]
    _due: float = 0.0
    _thread: Thread | None = None

    def save_if_due(self, localiser: Localiser, offset_ns: int) -> None:
        """Save every few seconds, unless the last one is still being written. offset_ns: of the robot's clock."""
        if time.monotonic() >= self._due and (self._thread is None or not self._thread.is_alive()):
            self._due = time.monotonic() + EVERY_S
            self._thread = Thread(target=self._write, args=(localiser.save(-offset_ns),), name="checkpoint")
            self._thread.start()

    def close(self, localiser: Localiser | None, offset_ns: int) -> None:
        """Save how the run ended."""
        if self._thread is not None:
            self._thread.join()
        if localiser is not None and localiser.state.is_begun:
            self._write(localiser.save(-offset_ns))

    def _write(self, content: bytes) -> None:
        try:
            write_bytes(self.path, content, durably=True)
        except OutputError as error:
            self.failed(f"The state is not saved: {error}")


@dataclass(slots=True, eq=False)
class Resumed:
    """A run that goes on from what was saved. text: what there is to say of that. content: what it went on from."""

    path: Path
    text: str = field(default="", init=False)
    content: bytes = field(init=False)

    def __post_init__(self) -> None:
        """Read the state. Raises InputError where it is damaged."""
        self.content = read_bytes(self.path, MAX_BYTES)

    def is_on(self, landmark_map: LandmarkMap) -> bool:
        """Whether the state belongs to a map."""
        own = identity_of({}, map=landmark_map.without_remarks())["map"]
        return checkpoint_of(self.content, self.path).identity.get("map") == own

    def begin(self, localiser: Localiser, timeline: Timeline, t_ns: int) -> Start:
        """Restore the saved state before the first image, which is at `t_ns`; return about where that is.

        Wheels that have gone on counting tell what happened in between; those that begin anew do not, and the robot
        is taken to be where it was. Raises InputError when the state belongs to another map, camera or setting.
        """
        localiser.restore(self.content, self.path)
        state, first = localiser.state, timeline.first_odometry
        if state.odometry and first is not None and is_driven(state.odometry[-1], first):
            timeline.resume(state.odometry[-1])
            self.text = "resumed; the wheels tell what happened in between"
        else:
            state.odometry.clear()
            state.begin_at(t_ns if first is None else min(first.t_ns, t_ns))
            self.text = "resumed; the wheels begin anew, so the robot is taken to be where it was"
        self.content = localiser.save()
        found = state.belief.places(state.particles)[1]
        return Start(state.at_ns, found.pose, found.pose_cov)


# -- the run ----------------------------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class Tracker:
    """Follows the robot. localiser_of: is called once the camera is known. landmark_map: the map, or several.

    start: given by the user, without its time; None looks for the robot everywhere. resumed: a saved state, which comes
    before it. checkpoints: saves the state, None where it is not saved.
    """

    finder: CameraFinder
    localiser_of: Callable[[Camera, LandmarkMap], Localiser]
    landmark_map: LandmarkMap
    clocks: Clocks
    outputs: Outputs
    start: Start | None = None
    resumed: Resumed | None = None
    checkpoints: Checkpoints | None = None
    localiser: Localiser | None = None
    timeline: Timeline = field(init=False)
    _truth: deque[tuple[int, Array]] = field(default_factory=lambda: deque(maxlen=500))
    _newest_odometry: tuple[int, Array] | None = None
    _intervals_s: deque[float] = field(default_factory=lambda: deque(maxlen=50))
    _costs_s: deque[float] = field(default_factory=lambda: deque(maxlen=50))

    def __post_init__(self) -> None:
        self.timeline = Timeline(self.outputs.decide, lambda frame: self.finder.mount_reaches(frame.stamp_ns))

    @property
    def newest_ns(self) -> int:
        """The time of the newest pose of the wheels, or of the last image where that is newer."""
        return max(self.timeline.newest_ns, self.timeline.weighed_ns)

    @property
    def is_idle(self) -> bool:
        """Whether there is nothing to do before more messages come."""
        waiting = self.timeline.waiting
        return waiting is None or waiting.measured is not None or self.localiser is None

    # -- in ---------------------------------------------------------------------------------------------------------

    def add_frame(self, frame: WaitingImage) -> None:
        """Take in an image; the first since the camera is known begins the run."""
        self._begin(frame.t_ns)
        self.timeline.add_frame(frame)

    def add_odometry(self, t_ns: int, number: int, pose: Array, at_ns: int) -> bool:
        """Take in a pose (3,) of the wheels; see `Timeline`. Return whether it is the newest."""
        before = self._newest_odometry
        if before is not None:
            self._intervals_s.append((t_ns - before[0]) / 1e9)
        self.timeline.add_odometry(t_ns, number, pose, at_ns)
        if before is not None and t_ns <= before[0]:
            return False
        self._newest_odometry = t_ns, pose
        return True

    def add_truth(self, t_ns: int, pose: Array) -> bool:
        """Take in a true pose (3,), which tells the error; return whether it is later than those before."""
        if self._truth and t_ns <= self._truth[-1][0]:
            return False
        self._truth.append((t_ns, pose))
        return True

    # -- where the robot starts ---------------------------------------------------------------------------------------

    def _begin(self, t_ns: int) -> None:
        """Make the localiser with the first image since the camera is known, and start it if it is known where."""
        camera, outputs = self.finder.camera, self.outputs
        if self.localiser is not None or camera is None:
            return
        self.localiser = self.localiser_of(camera, self.landmark_map)
        self.timeline.needs_wheels = self.localiser.config.increments.source != "vision"
        outputs.monitor.inform("the camera is known")
        outputs.publisher.begin(self.localiser.landmark_map, camera, self.clocks.stamp_of(t_ns))
        if self.resumed is not None:
            outputs.decide(start_decision(self.resumed.begin(self.localiser, self.timeline, t_ns)))
            outputs.tell(STATE_TOPIC, b64encode(self.resumed.content).decode())
            outputs.monitor.inform(self.resumed.text)
        elif self.start is not None:
            self._restart(replace(self.start, t_ns=t_ns))
        else:
            outputs.decide(anywhere_decision())
            outputs.monitor.inform("no start is known: the robot is looked for on the whole map")

    def state_pose(self, start: Start) -> None:
        """Take a pose that a user states: from now on, or from the first image on."""
        if self.localiser is None:
            self.start, self.resumed = replace(start, t_ns=0), None
        else:
            self._restart(start)

    def begin_anew(self) -> None:
        """Forget where the robot was, because its time began anew: it is where it started, or anywhere.

        A pose that was stated while driving was meant for a later time; a bag that is played again states it again.
        """
        self.finder.forget_moving()
        self.outputs.publisher.clock_jumped()
        self.outputs.publisher.forget()
        if self.localiser is None:
            return
        if self.start is not None:
            self._restart(replace(self.start, t_ns=self.newest_ns + 1))
        else:
            self.look_everywhere()

    def look_everywhere(self) -> None:
        """Forget where the robot is, and look for it on the whole map from the next image on."""
        self.start, self.resumed = None, None
        if self.localiser is None:
            return
        if not self.localiser.can_look_everywhere:
            text = "these settings cannot look for the robot on the whole map"
            self.outputs.monitor.warn("no global localisation", text)
            return
        t_ns = self.timeline.restart(self.newest_ns)
        self.localiser.look_everywhere(t_ns)
        self.outputs.publisher.forget()
        self.outputs.decide(anywhere_decision(t_ns))
        self.outputs.monitor.inform("the robot is looked for on the whole map")

    def load_map(self, landmark_map: LandmarkMap) -> None:
        """Go on with another map: the robot took the lift. What was believed is forgotten. Raises InputError.

        A recording belongs to one map and ends here. A state that is saved from here on belongs to the new map.
        """
        before, camera = self.localiser, self.finder.camera
        after = None if before is None or camera is None else Localiser(landmark_map, camera, before.config)
        self.landmark_map, self.start, self.resumed = landmark_map, None, None
        if before is None or camera is None or after is None:
            return
        self.localiser = after
        self.outputs.end_recording("because it belongs to the map before")
        self.timeline.restart(self.clocks.robot.newest_ns + 1)  # what was seen before belongs to the map before
        for pose in before.state.odometry:
            self.localiser.odometry(pose.t_ns, pose.pose)
        self.outputs.publisher.begin(landmark_map, camera, self.clocks.stamp_of(self.timeline.weighed_ns))
        name = landmark_map.name or "another one"
        self.outputs.monitor.inform(f"the map is now {name}; the robot is looked for on the whole of it")

    def close(self) -> None:
        """Save how the run ended."""
        if self.checkpoints is not None:
            self.checkpoints.close(self.localiser, self.clocks.robot.offset_ns)

    def _restart(self, start: Start) -> None:
        assert self.localiser is not None
        begun = replace(start, t_ns=self.timeline.restart(start.t_ns))
        self.localiser.start(begun.mean, begun.cov, begun.t_ns)
        self.outputs.decide(start_decision(begun))
        name = self.landmark_map.map_at(begun.mean)
        x, z, heading = begun.mean - self.landmark_map.origin(name)
        on = f" on {name}" if name else ""
        text = f"started at x = {x:.2f} m, z = {z:.2f} m, heading = {np.rad2deg(heading):.1f}°{on}"
        self.outputs.monitor.inform(text)

    # -- images -------------------------------------------------------------------------------------------------------

    def weigh_next(self) -> None:
        """Weigh one image, or find the edges of one that waits for the wheels."""
        if self.localiser is None:
            return
        affordable = 1  # images that there is time for until the wheels report again
        if min(len(self._costs_s), len(self._intervals_s)) >= 5:
            affordable = int(median(self._intervals_s) / median(self._costs_s))
        frame = self.timeline.next(affordable, self.clocks.now_ns)
        if frame is not None:
            self._weigh(self.localiser, frame)
            return
        waiting = self.timeline.waiting
        if waiting is None or waiting.measured is not None or self.localiser.camera.shutter is not None:
            return
        if self.finder.mount_reaches(waiting.stamp_ns):
            self._find_edges(self.localiser, waiting)

    def _find_edges(self, localiser: Localiser, frame: WaitingImage) -> None:
        """Find the edges of an image; an image that is damaged is left out."""
        try:
            pixels = grey_image(frame.message)
            image = image_file(frame.message) if pixels is None else pixels
            twist = localiser.camera.twist_at(self.timeline.track, frame.t_ns)
            frame.measured = localiser.measure(image, self.finder.mount_at(frame.stamp_ns), twist)
        except (InputError, ValueError) as error:
            self.outputs.monitor.warn("bad image", f"left out an image: {error}")
            self.timeline.discard(frame, "damaged")

    def _weigh(self, localiser: Localiser, frame: WaitingImage) -> None:
        begin = time.perf_counter()
        if frame.measured is None:
            self._find_edges(localiser, frame)
        if frame.measured is None:
            return
        for pose in self.timeline.release(frame):
            localiser.odometry(pose.t_ns, pose.pose)
        (found,) = localiser.edges(frame.t_ns, frame.measured, by_wheels=frame.by_wheels)
        found = replace(found, truth=self._true_pose(frame.t_ns))
        if found.located.p_correct > SURE:
            stated_m = localiser.camera.at(found.located.edges.mount).mount.height_m
            if off := found.located.height.warning(stated_m):
                self.outputs.monitor.warn("height", off)
        for text in localiser.markers.warnings(localiser.landmark_map):
            self.outputs.monitor.warn(text.partition(" is ")[0].lower(), text)
        self.outputs.located(found, self._published(frame, found), plain_frame(frame.message.header.frame_id))
        self._costs_s.append(time.perf_counter() - begin)
        if self.checkpoints is not None:
            self.checkpoints.save_if_due(localiser, self.clocks.robot.offset_ns)

    def _published(self, frame: WaitingImage, found: LocatedFrame) -> Published:
        """Return what goes out of an image: the estimate, and moved on by what the wheels did since."""
        located, truth = found.located, found.truth
        now_ns, odometry_now = self._newest_odometry or (frame.t_ns, located.odometry)
        if now_ns < frame.t_ns:
            now_ns, odometry_now = frame.t_ns, located.odometry
        return Published(
            located,
            frame.stamp_ns,
            self.clocks.stamp_of(now_ns),
            compose(located.estimate.pose, between(located.odometry, odometry_now)),
            self.clocks.latency_ms(frame.stamp_ns),
            found.map_name,
            None if truth is None else float(np.hypot(*(located.estimate.pose - truth)[:2])),
        )

    def _true_pose(self, t_ns: int) -> Array | None:
        if len(self._truth) < 2 or not self._truth[0][0] <= t_ns <= self._truth[-1][0]:
            return None
        times, poses = zip(*self._truth, strict=True)
        return Trajectory(np.array(times), np.array(poses)).at(t_ns)
