"""Replay a log: events in, edges found, pose located, results out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import numpy as np

from localiser import view
from localiser.config import Config, in_force, to_yaml
from localiser.edges import find_edges, warm_up
from localiser.errors import InputError, LocaliserError, RunEndedEarlyError
from localiser.filter import Event as FilterEvent
from localiser.filter import Image, Located, LocatedFrame, Mcl, Sighting, finish, matched, step
from localiser.geometry import compose
from localiser.localiser import filter_of
from localiser.observation import EdgeObservation, observation_of
from localiser.replay.checkpoints import STAGES, Checkpoints, Running, begun, resumed
from localiser.replay.run_figures import write_figures
from localiser.replay.run_inputs import RunInputs, map_of
from localiser.replay.sinks import History, Sink, close_all
from localiser.replay.start import start_of
from localiser.replay.stop import stop_request
from localiser.storage import Event, ImageEvent, Log, RunFolder, TrackWriter, camera_error, require_new_file
from localiser.view import LiveView
from localiser.visual_odometry import Odometer

SIGINT_EXIT_CODE = 130


@dataclass(frozen=True, slots=True)
class Outputs:
    """What a replay writes and shows.

    results: folder of all results. view: a live viewer. checkpoints: where to save what it takes to resume the run.
    """

    results: Path
    rrd: bool = True
    view: Literal["native", "web", "none"] = "none"
    checkpoints: Checkpoints | None = None


@dataclass(slots=True, eq=False)
class Pending:
    """An image between its arrival and its result: what it shows and the time its stages took (ms)."""

    image: Image | None
    stage_ms: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """One run of the filter over a log, and where its results go."""

    inputs: RunInputs
    observation: EdgeObservation
    filter: Mcl
    running: Running
    folder: RunFolder
    history: History
    sinks: Sequence[Sink]
    live: LiveView | None
    checkpoints: Checkpoints | None

    def run(self, progress: Callable[[], None]) -> dict[str, Any]:
        """Replay the log, call `progress` after every frame, and return the metrics.

        Raises RunEndedEarlyError when a frame is bad or the user stops it; everything located until then is on disk.
        """
        try:
            self._write_inputs()
            with stop_request() as stop_if_asked:
                self._repeat(progress)
                self._replay(progress, stop_if_asked)
        except KeyboardInterrupt as stop:
            raise self._end_early("stopped", SIGINT_EXIT_CODE) from stop
        except LocaliserError as error:
            raise self._end_early(str(error), error.exit_code) from error
        except BaseException:
            close_all(self.sinks, complete=False)
            raise
        close_all(self.sinks, complete=True)
        with stop_request():  # the run is done: Ctrl-C does not take its figures away
            figures = self._write_figures(complete=True)
            self._save_checkpoint()
            return figures

    def _repeat(self, progress: Callable[[], None]) -> None:
        """Hand over what was located before the run was resumed."""
        for frame in self.running.done.frames:
            for sink in self.sinks:
                sink.frame(frame)
            progress()

    def _replay(self, progress: Callable[[], None], stop_if_asked: Callable[[], None]) -> None:
        config, done = self.inputs.config, self.running.done
        filter_ = self.filter
        by_edges = Odometer(self.inputs.log.camera, replace(config.increments, source="vision"))
        blind = replace(filter_, odometer=by_edges)  # for images of a live run whose wheels were silent
        state, rng = self.running.state, self.running.rng
        events = self.inputs.log.events(self.inputs.start, anywhere=self.inputs.start is None)
        pending = self._still_waiting(islice(events, done.events))

        def steps() -> Iterator[Iterator[Located]]:
            for event in events:
                measured = self._measure(event, pending)
                done.events += 1
                sees_wheels = not isinstance(event, ImageEvent) or event.by_wheels
                yield step(filter_ if sees_wheels else blind, state, measured, rng)
            yield finish(filter_, state, rng)

        for located_frames in steps():
            for located, milliseconds in timed(located_frames):
                frame = pending.pop(located.t_ns)
                frame.stage_ms["filter"] = milliseconds
                self._hand_over(located, frame)
                progress()
                if self.checkpoints is not None and self.checkpoints.is_due(len(self.history.frames)):
                    self._save_checkpoint()
                stop_if_asked()

    def _still_waiting(self, taken: Iterator[Event]) -> dict[int, Pending]:
        """Pass over events that were taken before; return the images among them that still wait for odometry."""
        waiting = {sighting.t_ns for sighting in self.running.state.waiting}
        images = (event for event in taken if isinstance(event, (ImageEvent, Sighting)) and event.t_ns in waiting)
        return {
            event.t_ns: Pending(event.encoded() if isinstance(event, ImageEvent) else None, {"load": 0.0, "edges": 0.0})
            for event in images
        }

    def _measure(self, event: Event, pending: dict[int, Pending]) -> FilterEvent:
        """Return the event with its image turned into edges."""
        if isinstance(event, Sighting):
            pending[event.t_ns] = Pending(None, {"load": 0.0, "edges": 0.0})
        if not isinstance(event, ImageEvent):
            return event
        begin = perf_counter()
        image, encoded = event.load(), event.encoded()
        loaded = perf_counter()
        edges = find_edges(image, self.inputs.log.camera, self.inputs.config.edges)
        found = perf_counter()
        pending[event.t_ns] = Pending(encoded, {"load": 1e3 * (loaded - begin), "edges": 1e3 * (found - loaded)})
        return Sighting(event.t_ns, edges)

    def _by_what_was_followed(self, located: Located) -> Located:
        """Return the result; where increments are not of wheels alone, all of them together are its odometry."""
        if self.inputs.config.increments.source == "wheel":
            return located
        before = self.history.frames[-1].located.odometry if self.history.frames else np.zeros(3)
        return replace(located, odometry=compose(before, located.increment.mean))

    def _hand_over(self, located: Located, pending: Pending) -> None:
        located = self._by_what_was_followed(located)
        truth = self.inputs.log.groundtruth
        true_pose = truth.at(located.t_ns) if truth is not None and truth.covers(located.t_ns) else None
        matches = matched(self.filter, located)
        begin = perf_counter()
        for sink in self.sinks:
            sink.frame(LocatedFrame(located, matches, pending.image, true_pose, pending.stage_ms))
        stage_ms = pending.stage_ms | {"sinks": 1e3 * (perf_counter() - begin)}
        for stage in STAGES:
            self.running.done.timing[stage].append(stage_ms[stage])

    def _end_early(self, reason: str, exit_code: int) -> RunEndedEarlyError:
        """Save what was done and return the error that says how much that is and where."""
        close_all(self.sinks, complete=False)
        done, frames = len(self.history.frames), len(self.inputs.log.frames)
        if done:
            self._write_figures(complete=False)
            self._save_checkpoint()
        resume = f"; go on with --resume {self.checkpoints.path}" if done and self.checkpoints else ""
        return RunEndedEarlyError(
            f"{reason}. The run ended after {done} of {frames} frames; what was done is in {self.folder.path}{resume}",
            exit_code,
        )

    def _save_checkpoint(self) -> None:
        if self.checkpoints is not None:
            self.running.done.frames = self.history.frames
            self.checkpoints.save(self.inputs, self.running)

    def _write_inputs(self) -> None:
        self.folder.write_text("config.yaml", to_yaml(in_force(self.inputs.config)))
        self.folder.write_text("run.yaml", self.inputs.described())

    def _write_figures(self, complete: bool) -> dict[str, Any]:
        return write_figures(self.inputs, self.folder, self.history, self.running.done.timing, complete=complete)


def prepare(
    log: Log,
    config: Config,
    outputs: Outputs,
    start_option: str | None = None,
    *,
    map_file: Path | None = None,
    resume: Path | None = None,
) -> Replay:
    """Return a replay of `log`, its folder made and its sinks open.

    start_option: see `start_of`. map_file: of a map in place of the log's own. resume: checkpoint of a run to go on
    with. Raises InputError when the map is missing, camera and observation do not fit or the checkpoint is another
    run's, OutputError when results cannot be written.
    """
    landmark_map = map_of(log, map_file)
    _require_fitting(log, config)
    if outputs.checkpoints is not None and outputs.checkpoints.path != resume:
        require_new_file(outputs.checkpoints.path)
    rng = np.random.default_rng(config.seed)
    inputs = RunInputs(log, landmark_map, map_file, config, start_of(log, start_option, rng))
    running = begun(inputs, rng) if resume is None else resumed(resume, inputs)
    observation = observation_of(log.camera, config.observation)
    filter_ = filter_of(log.camera, landmark_map, observation, config)
    if log.has_images:
        warm_up(log.camera, config.edges)

    folder = RunFolder.create(outputs.results, log.name)
    history = History()
    sinks: list[Sink] = [history, TrackWriter(folder.path)]
    context = view.Context(log.name, log.camera, landmark_map, truth=log.groundtruth, images=log.has_images)
    if outputs.rrd:
        sinks.append(view.RrdFile(folder.path / "run.rrd", context))
    live = view.LiveView(outputs.view, context) if outputs.view != "none" else None
    if live is not None:
        sinks.append(live)
    return Replay(inputs, observation, filter_, running, folder, history, sinks, live, outputs.checkpoints)


def _require_fitting(log: Log, config: Config) -> None:
    if config.observation.kind == "slope" and abs(np.sin(log.camera.mount.tilt_rad)) < np.sin(np.deg2rad(0.1)):
        raise camera_error(
            log.path,
            ("mount", "tilt_deg"),
            "the observation `slope` needs a tilted camera, found a tilt of "
            f"{np.rad2deg(log.camera.mount.tilt_rad):g}°: without tilt every vertical edge is vertical in the image; "
            "use --observation line",
        )
    if config.observation.association == "known" and log.has_images:
        raise InputError(
            "association: known believes edges that say which landmark they belong to, found a log of images: "
            "leave it unknown",
            path=log.path,
            field="images",
        )
    if config.increments.source != "wheel" and not log.has_images:
        raise InputError(
            f"`--odometry {config.increments.source}` follows edges from image to image, found a log without images: "
            "bearings alone tell neither how far the robot went nor which edge is which; use --odometry wheel",
            path=log.path,
            field="images",
        )


def timed(items: Iterator[Located]) -> Iterator[tuple[Located, float]]:
    """Yield each item with the milliseconds that it took to come."""
    while True:
        begin = perf_counter()
        item = next(items, None)
        if item is None:
            return
        yield item, 1e3 * (perf_counter() - begin)
