"""Replay a log: pass its measurements to a localiser in the order of time, and the results to every sink."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from localiser import evaluate
from localiser.config import Config, in_force, read_config, to_yaml, with_seed
from localiser.edges import Detector, Light, light_of
from localiser.errors import InputError, LocaliserError, OutputError, RunEndedEarlyError
from localiser.evaluate import Track, write_report
from localiser.filter import Anywhere, LocatedFrame, Odometry, Sighting, Start
from localiser.geometry import compose
from localiser.landmarks import LandmarkMap
from localiser.localiser import Localiser, MeasuredImage, check_settings
from localiser.motion import MotionModel
from localiser.observation import Observation
from localiser.replay.about import described, identity_of
from localiser.replay.ahead import in_order
from localiser.replay.bag import ReplayBag
from localiser.replay.figures import Summary, bound_of, run_metrics, truth_of
from localiser.replay.kept import KeptFrames
from localiser.replay.sinks import Outputs, Sink, all_of, close_all, sinks_of, without_bulk
from localiser.replay.start import has_start, start_of
from localiser.replay.stop import Stop, asked_to_stop
from localiser.storage import (
    ImageEvent,
    Log,
    RunFolder,
    TrackWriter,
    camera_error,
    checkpoint_of,
    open_log,
    read_map,
    require_odometry,
)
from localiser.view import Context, LiveView

LIT_EVERY = 5  # images, of which one is looked at for its light
STAGES = ("load", "edges", "filter", "sinks")


def _is_image(event: object) -> bool:
    return isinstance(event, ImageEvent)


@dataclass(frozen=True, eq=False)
class Replay:
    """A log that is replayed, and what was located until now.

    localiser: as it was made for this run; it has the map, which was read from `map_file` where that is not None, and
    the settings. start: None where nothing is said of it. frames: without images and particles, in a temporary file
    where there are many. light: how every fifth image is exposed. timing: what each of them took (ms), by stage.
    """

    log: Log
    localiser: Localiser
    start: Start | None
    map_file: Path | None = None
    frames: KeptFrames = field(default_factory=KeptFrames)
    light: list[Light] = field(default_factory=list)
    _summaries: dict[int, Summary] = field(default_factory=dict)
    timing: dict[str, list[float]] = field(default_factory=lambda: {stage: [] for stage in STAGES})

    @cached_property
    def identity(self) -> dict[str, str]:
        """What the run was made from: every setting by its name, and fingerprints of map, camera and log."""
        return identity_of(self)

    @property
    def track(self) -> Track:
        """The run so far."""
        return self.summary.track

    @property
    def summary(self) -> Summary:
        """What is wanted of all images so far at once."""
        if len(self.frames) not in self._summaries:
            self._summaries.clear()
            self._summaries[len(self.frames)] = Summary.of(self.frames, len(self.localiser.landmark_map))
        return self._summaries[len(self.frames)]

    @property
    def metrics(self) -> dict[str, Any]:
        """The figures of the run so far, as `metrics.json` has them."""
        return run_metrics(self, bound_of(self))

    def run(self, sinks: Sequence[Sink] = (), after_each: Callable[[], None] = lambda: None) -> None:
        """Replay the log: hand every located image to the sinks, then call `after_each`.

        Raises InputError for an image that cannot be read, and in the end where the log could not be read further.
        """
        for found in self._steps():
            for frame in found:
                self._hand_over(self._completed(frame), sinks)
                after_each()

    def _steps(self) -> Iterator[list[LocatedFrame]]:
        localiser = self.localiser
        events = self.log.events(self.start, anywhere=self.start is None)
        events = islice(events, self._resumed(), None)
        threads = localiser.config.observation.threads
        for event, measured in in_order(events, self._measured, _is_image, threads):
            match event:
                case Start():
                    yield localiser.start(event.mean, event.cov, event.t_ns)
                case Anywhere():
                    yield localiser.look_everywhere(event.t_ns)
                case Odometry():
                    yield localiser.odometry(event.t_ns, event.pose)
                case Sighting() if event.measurement is not None:
                    yield localiser.measurement(event.t_ns, event.measurement)
                case Sighting():
                    yield localiser.edges(event.t_ns, event.edges)
                case ImageEvent() if measured is not None:
                    yield self._image(event, measured())
        yield localiser.finish()
        if self.log.fault is not None:
            raise self.log.fault

    def _measured(self, event: ImageEvent) -> MeasuredImage:
        data = event.encoded()
        try:
            return self.localiser.measure(data, event.mount, self.log.twist_at(event.t_ns))
        except InputError as error:
            raise self._named(error, event) from None

    def _image(self, event: ImageEvent, measured: MeasuredImage) -> list[LocatedFrame]:
        try:
            return self.localiser.edges(event.t_ns, measured, event.mount, by_wheels=event.by_wheels)
        except InputError as error:
            raise self._named(error, event) from None

    def _named(self, error: InputError, event: ImageEvent) -> InputError:
        return InputError(error.problem, path=self.log.path, field=event.name)

    def _completed(self, frame: LocatedFrame) -> LocatedFrame:
        """Return the frame with the truth; its odometry is what the run went by, which need not be the wheels alone."""
        located, truth = frame.located, self.log.groundtruth
        if self.localiser.config.increments.source != "wheel":
            before = self.frames[-1].located.odometry if self.frames else np.zeros(3)
            located = replace(located, odometry=compose(before, located.increment.mean))
        true_pose = truth.at(located.t_ns) if truth is not None and truth.covers(located.t_ns) else None
        return replace(frame, located=located, truth=true_pose)

    def _hand_over(self, frame: LocatedFrame, sinks: Sequence[Sink]) -> None:
        begin = perf_counter()
        self.frames.append(without_bulk(frame))
        if frame.image is not None and len(self.frames) % LIT_EVERY == 1:
            self.light.append(light_of(frame.image))
        for sink in sinks:
            sink.frame(frame)
        stage_ms = {**frame.stage_ms, "sinks": 1e3 * (perf_counter() - begin)}
        for stage in STAGES:
            self.timing[stage].append(stage_ms[stage])

    def _resumed(self) -> int:
        """Go on from where the live run went on that the log is a recording of; return how many events that replaces.

        That is the start. A state belongs to its settings, map and camera: with others the replay starts about there,
        as for any start. Raises InputError when the state is damaged.
        """
        log, localiser = self.log, self.localiser
        if not log.resumed or self.start is not log.start:
            return 0
        if checkpoint_of(log.resumed, log.path).identity != localiser.identity:
            return 0
        localiser.restore(log.resumed, log.path)
        return 1


def prepare(
    log: Log,
    config: Config,
    start: str | Start | None = None,
    *,
    landmark_map: LandmarkMap | None = None,
    map_file: Path | None = None,
    **own: Any,
) -> Replay:
    """Return a replay of `log` that is ready to run.

    start: see `start_of`. landmark_map, or that in map_file, takes the place of the log's own. own: observation, motion
    and detector, see `Localiser`. Raises InputError when the map is missing, or settings, camera and log do not fit.
    """
    if landmark_map is None:
        landmark_map = read_map(map_file) if map_file else log.landmark_map
    if landmark_map is None:
        raise InputError(
            f"the log has no map; expected --map MAP. `localiser map build {log.path} --poses slam -o map.yaml` makes "
            "one of the log itself, `localiser map plan` of a floor plan",
            path=log.path,
            field="map",
        )
    if config.increments.source != "vision":
        require_odometry(log, f"`increments.source: {config.increments.source}`")
    try:
        check_settings(
            config,
            log.camera,
            images=log.has_images,
            has_start=has_start(log, start),
            own_observation=own.get("observation") is not None,
        )
    except InputError as error:
        raise _placed(error, log) from None
    if config.observation.association == "known" and landmark_map is not log.landmark_map:
        log = log.identified_on(landmark_map)
    localiser = Localiser(landmark_map, log.camera, config, **own)
    return Replay(log, localiser, start_of(log, start, localiser.rng), map_file)


def _placed(error: InputError, log: Log) -> InputError:
    """Return the error with the file of the log that does not fit the settings."""
    if error.field == "mount.tilt_deg":
        return camera_error(log.path, ("mount", "tilt_deg"), error.problem)
    return InputError(error.problem, path=log.path, field=error.field)


def replay_log(
    log: Log | Path | str,
    config: Config | None = None,
    *,
    landmark_map: LandmarkMap | None = None,
    start: str | Start | None = None,
    seed: int | None = None,
    sinks: Sequence[Sink] = (),
    observation: Observation | None = None,
    motion: MotionModel | None = None,
    detector: Detector | None = None,
) -> Replay:
    """Replay a log and return what was located: `frames`, `track` and `metrics`. Writes nothing itself.

    log: as `open_log` gives it, or its path. config: settings in place of the defaults and of what the log asks for.
    landmark_map: in place of the log's own. start: where the robot starts, or `x,z,heading_deg`, `truth` or `global` as
    on the command line; by default what the log states, else anywhere. seed: in place of the configuration's. sinks:
    get every located image, and are closed. observation, motion, detector: see `Localiser`. Raises InputError.
    """
    log = log if isinstance(log, Log) else open_log(log)
    config = read_config(None, (), log.settings) if config is None else config
    config = with_seed(config, seed)
    own: dict[str, Any] = {"observation": observation, "motion": motion, "detector": detector}
    run = prepare(log, config, start, landmark_map=landmark_map, **own)
    complete = False
    try:
        run.run(sinks)
        complete = True
    finally:
        close_all(sinks, complete)
    return run


# -- into a folder ----------------------------------------------------------------------------------------------------


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
        return cls(replay, folder, [*sinks_of(outputs, folder.path, context), *bags], outputs.report, is_new)

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
            self.folder.write_text("config.yaml", to_yaml(in_force(self.replay.localiser.config)))
            self.folder.write_text("run.yaml", described(self.replay))
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
        bound, timing = bound_of(run), evaluate.timing_metrics(run.timing)
        figures = run_metrics(run, bound) | {"complete": complete}
        report = folder.path / "report.png"
        known = {
            "truth": truth_of(run),
            "landmark_map": run.localiser.landmark_map,
            "bound": bound,
            "landmark_use": run.summary.landmark_use,
        }
        reports = [
            lambda: write_report(report, run.track, figures | timing, **known),
            lambda: folder.write_text("report.html", self._page(figures | timing, report)),
        ]
        all_of(
            [
                lambda: close_all(tracks, complete),
                lambda: folder.write_json("metrics.json", figures),
                lambda: folder.write_json("timing.json", timing),
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
