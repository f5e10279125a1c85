"""A replay whose results go into a folder: its sinks, its bag, how it is stopped, and what is written in the end."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any, Literal

import numpy as np

from localiser import evaluate
from localiser.config import in_force, to_yaml
from localiser.errors import InputError, LocaliserError, OutputError, RunEndedEarlyError
from localiser.evaluate import WorstMoments, write_report
from localiser.filter import LocatedFrame
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.replay.figures import run_metrics, run_yaml, truth_of
from localiser.replay.run import Replay, Sink, all_of, close_all
from localiser.ros import OUTPUTS, Message, Outgoing
from localiser.storage import Log, RunFolder, TrackWriter, json_text, require_new_file, write_text
from localiser.storage.bags import (
    FILE_KINDS,
    WHEELS_TOPIC,
    Messages,
    NewBag,
    RosType,
    check_times,
    floor_pose,
    log_messages,
    new_bag,
    write_message,
)
from localiser.view import Context, LiveView, RrdFile


@dataclass(frozen=True, slots=True)
class Outputs:
    """What a replay writes and shows.

    results: folder of all results. rrd: whether to record. view: a live viewer. report: whether to draw report.png.
    bag: a ROS 2 bag of the log and what was located, None for none.
    """

    results: Path
    rrd: bool = True
    view: Literal["native", "web", "none"] = "none"
    report: bool = True
    bag: Path | None = None


SINKS: list[Callable[[Outputs, Path, Context], Sink | None]] = [
    lambda outputs, folder, context: TrackWriter(folder),
    lambda outputs, folder, context: WorstMoments(),
    lambda outputs, folder, context: RrdFile(folder / "run.rrd", context) if outputs.rrd else None,
    lambda outputs, folder, context: LiveView(outputs.view, context) if outputs.view != "none" else None,
]
"""What makes the sinks of a replay, each from what was asked for, the run's folder and what a view must know."""


# -- a bag of the log and what was located in it, for RViz, Foxglove, PlotJuggler and Rerun ---------------------------

SUFFIXES = (".mcap", ".db3")


class ReplayBag:
    """A sink that writes a bag: everything that the log has, and the topics of `localiser.ros` beside it.

    Everything has the time of the log. The transform from the map to the odometry's frame is written for every pose of
    the wheels and for every image, with its own stamp; the one from there to the robot too, which a robot sends itself.
    A run that ends early leaves a bag until there.
    """

    def __init__(self, path: Path, log: Log, landmark_map: LandmarkMap, *, by_wheels: bool = True) -> None:
        """Prepare; the bag is made with the first image. Raises InputError, OutputError for a path that is taken.

        by_wheels: whether the wheels are the odometry of the run, and not its images.
        """
        if path.suffix not in SUFFIXES:
            raise InputError(f"expected a path that ends in {' or '.join(SUFFIXES)}, found {path}", field="--bag")
        require_new_file(path)
        check_times(log)
        self._path, self._log, self._by_wheels = path, log, by_wheels
        self._make = Messages()
        self._outgoing = Outgoing(landmark_map, log.camera, tolerance_ns=0)
        self._stack = ExitStack()
        self._bag: NewBag | None = None
        self._messages: Iterator[tuple[str, int, Any]] = iter(())
        self._next: tuple[str, int, Any] | None = None

    def frame(self, frame: LocatedFrame) -> None:
        """Write what the log has until an image, and what was located in it. Raises OutputError."""
        bag = self._bag or self._begun()
        t_ns = frame.located.t_ns
        self._write_log(bag, t_ns)
        off_m = None if frame.truth is None else np.hypot(*(frame.located.estimate.pose - frame.truth)[:2])
        for message in self._outgoing.image(frame, t_ns, facts={} if off_m is None else {"error_m": f"{off_m:.4f}"}):
            self._write(bag, message)
        self._write_transforms(bag, t_ns, None if self._by_wheels else frame.located.odometry)

    def close(self, complete: bool) -> None:
        """Write the rest of the log, if the run came to its end, and end the bag. Raises OutputError."""
        with self._stack:
            if complete and self._bag is not None:
                self._write_log(self._bag, None)

    def _begun(self) -> NewBag:
        bag = self._bag = self._stack.enter_context(new_bag(self._path, FILE_KINDS[self._path.suffix]))
        self._messages = log_messages(replace(self._log, landmark_map=self._outgoing.landmark_map), self._make)
        self._next = next(self._messages, None)
        for message in self._outgoing.landmarks(self._log.start_ns):
            self._write(bag, message)
        return bag

    def _write_log(self, bag: NewBag, until_ns: int | None) -> None:
        """Write what the log has until a time, or all of it."""
        while self._next is not None and (until_ns is None or self._next[1] <= until_ns):
            topic, t_ns, message = self._next
            write_message(bag, topic, t_ns, message)
            if topic == WHEELS_TOPIC and self._by_wheels:
                self._write_transforms(bag, t_ns, np.array(floor_pose(message)))
            self._next = next(self._messages, None)

    def _write_transforms(self, bag: NewBag, t_ns: int, odometry: Array | None) -> None:
        """Write map → odom, and odom → robot where a pose (3,) of the odometry is given, both for this time."""
        for message in self._outgoing.transform(t_ns):
            self._write(bag, message)
        if odometry is not None:
            driven = self._make.encode(self._make.robot_in_odometry(t_ns, odometry))
            bag.write(OUTPUTS["tf"].name, RosType.TRANSFORMS, t_ns, driven)

    def _write(self, bag: NewBag, message: Message) -> None:
        output = OUTPUTS[message.kind]
        bag.write(output.name, output.msgtype, message.stamp_ns, message.content, latched=output.latched)


# -- stopping between two images --------------------------------------------------------------------------------------

_SIGNALS = [signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]


class Stop(threading.Event):
    """Is set once the user, or the system, asks a run to stop. exit_code: how the program then ends, as shells do."""

    exit_code = 128 + signal.SIGINT


@contextmanager
def asked_to_stop() -> Iterator[Stop]:
    """Hold Ctrl-C, SIGTERM and SIGHUP back; yields an event that they set. A second one is not held back.

    A signal that is ignored, as SIGHUP under `nohup`, stays so. In other threads than the main one, which get no
    signals, nothing is changed.
    """
    asked = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def ask(number: int, _frame: FrameType | None) -> None:
        asked.exit_code = 128 + number
        asked.set()
        restore()

    held = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, ask) for number in held}
    try:
        yield asked
    finally:
        restore()


# -- the run ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class FolderRun:
    """A replay whose results go into a folder of its own. report: whether its report is drawn.

    is_new: whether the folder was made for it; then a run that comes to nothing leaves none.
    """

    replay: Replay
    folder: RunFolder
    sinks: Sequence[Sink]
    report: bool = True
    is_new: bool = False

    @classmethod
    def open(cls, replay: Replay, outputs: Outputs, folder: RunFolder | None = None) -> FolderRun:
        """Make the folder, unless there is one, and open the sinks. Raises OutputError."""
        log, landmark_map = replay.log, replay.localiser.landmark_map
        by_wheels = replay.localiser.config.increments.source == "wheel"
        bags = [ReplayBag(path, log, landmark_map, by_wheels=by_wheels) for path in (outputs.bag,) if path is not None]
        is_new = folder is None
        folder = folder or RunFolder.create(outputs.results, log.name)
        context = Context(log.name, log.camera, landmark_map, truth=log.groundtruth, images=log.has_images)
        sinks = [sink for make in SINKS if (sink := make(outputs, folder.path, context)) is not None]
        return cls(replay, folder, [*sinks, *bags], outputs.report, is_new)

    @property
    def viewer(self) -> LiveView | None:
        """Where the run is watched, None where it is not."""
        return next((sink for sink in self.sinks if isinstance(sink, LiveView)), None)

    def run(self, progress: Callable[[], None]) -> dict[str, Any]:
        """Replay the log, call `progress` after every frame, and return the metrics and what a frame took.

        Raises RunEndedEarlyError when a frame is bad or the user stops it; everything located until then is on disk.
        """
        asked = Stop()
        try:
            write_text(self.folder.path / "config.yaml", to_yaml(in_force(self.replay.localiser.config), ["live"]))
            write_text(self.folder.path / "run.yaml", run_yaml(self.replay))
            with asked_to_stop() as asked:

                def after_each() -> None:
                    progress()
                    if asked.is_set():
                        raise KeyboardInterrupt

                self.replay.run(self.sinks, after_each)
        except KeyboardInterrupt as stop:
            raise self._end_early("stopped", asked.exit_code) from stop
        except LocaliserError as error:
            raise self._end_early(str(error), error.exit_code) from error
        except BaseException:
            close_all(self.sinks, complete=False)
            raise
        with asked_to_stop():  # the run is done: Ctrl-C does not take its figures away
            try:
                return self._write_results(complete=True)
            except OutputError as error:
                raise OutputError(f"{error}. All else that the run came to is in {self.folder.path}") from error

    def _end_early(self, reason: str, exit_code: int) -> RunEndedEarlyError:
        """Save what was done and return the error that says how much that is and where."""
        done, frames = len(self.replay.frames), len(self.replay.log.frames)
        left = f"what was done is in {self.folder.path}" if done or not self.is_new else "nothing is left of it"
        text = f"{reason}. The run ended after {done} of {frames} frames; {left}"
        try:
            if done:
                self._write_results(complete=False)
            else:
                close_all(self.sinks, complete=False)
        except OutputError as error:
            if str(error) != reason:
                text += f", except {error}"
        if not done and self.is_new:
            self.folder.discard()
        return RunEndedEarlyError(text, exit_code)

    def _write_results(self, complete: bool) -> dict[str, Any]:
        """Write what was located in the order of its worth, and return the figures of metrics and timing.

        That is: the trajectory, `metrics.json` and `timing.json`, the recording and, if wanted, `report.png` and
        `report.html`. What cannot be written, as to a full disk, does not keep what comes later from being written.
        Raises the first OutputError then. What a frame took differs from run to run; the file of the metrics does not.
        """
        run, folder = self.replay, self.folder
        tracks = [sink for sink in self.sinks if isinstance(sink, TrackWriter)]
        others = [sink for sink in self.sinks if sink not in tracks]
        timing = evaluate.timing_metrics(run.timing)
        figures = run_metrics(run) | {"complete": complete}
        report = folder.path / "report.png"
        known = {
            "truth": truth_of(run),
            "landmark_map": run.localiser.landmark_map,
            "landmark_use": run.summary.landmark_use,
        }
        reports = [
            lambda: write_report(report, run.track, figures | timing, **known),
            lambda: write_text(folder.path / "report.html", self._page(figures | timing, report)),
        ]
        all_of(
            [
                lambda: close_all(tracks, complete),
                lambda: write_text(folder.path / "metrics.json", json_text(figures)),
                lambda: write_text(folder.path / "timing.json", json_text(timing)),
                lambda: close_all(others, complete),
                *(reports if self.report else []),
            ]
        )
        return figures | timing

    def _page(self, figures: dict[str, Any], report: Path) -> str:
        """Return the report as a page, with the worst moments of the run."""
        run = self.replay
        return evaluate.report_page(
            run.track,
            figures,
            next((sink.moments for sink in self.sinks if isinstance(sink, evaluate.WorstMoments)), []),
            camera=run.log.camera,
            landmark_map=run.localiser.landmark_map,
            picture=report.read_bytes() if report.is_file() else b"",
        )
