"""Replay a log: events in, edges found, pose located, results out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from localiser import evaluate, mcl, motion, view
from localiser.app.sinks import History, Sink, close_all
from localiser.app.start import start_of
from localiser.app.stop import stop_request
from localiser.app.tilt import mount_figures
from localiser.config import Config, in_force, to_yaml
from localiser.edges import Edges, find_edges
from localiser.errors import InputError, LocaliserError, RunEndedEarlyError
from localiser.frames import Image, LocatedFrame
from localiser.geometry import Array
from localiser.increments import Odometer
from localiser.landmarks import LandmarkMap
from localiser.observation import EdgeObservation
from localiser.storage import Event, ImageEvent, Log, RunFolder, TrackWriter, camera_error
from localiser.view import LiveView

STAGES = ("load", "edges", "filter", "sinks")
SIGINT_EXIT_CODE = 130


@dataclass(frozen=True, slots=True)
class Outputs:
    """What a replay writes and shows. results: folder of all results. view: a live viewer."""

    results: Path
    rrd: bool = True
    view: Literal["native", "web", "none"] = "none"


@dataclass(slots=True, eq=False)
class Pending:
    """An image between its arrival and its result: what it shows and the time its stages took (ms)."""

    image: Image | None
    stage_ms: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """One run of the filter over a log, and where its results go."""

    log: Log
    landmark_map: LandmarkMap
    config: Config
    start: mcl.Start
    rng: np.random.Generator
    observation: EdgeObservation
    folder: RunFolder
    history: History
    sinks: Sequence[Sink]
    live: LiveView | None
    timing: dict[str, list[float]] = field(default_factory=lambda: {stage: [] for stage in STAGES})

    def run(self, progress: Callable[[], None]) -> dict[str, Any]:
        """Replay the log, call `progress` after every frame, and return the metrics.

        Raises RunEndedEarlyError when a frame is bad or the user stops it; everything located until then is on disk.
        """
        try:
            self._write_config()
            with stop_request() as stop_if_asked:
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
            return self._write_figures(complete=True)

    def _replay(self, progress: Callable[[], None], stop_if_asked: Callable[[], None]) -> None:
        filter_ = mcl.Mcl(
            self.landmark_map,
            self.observation,
            self.config.mcl,
            self.config.motion,
            self.config.observation,
            odometer=Odometer(self.log.camera, self.config.increments),
        )
        state = mcl.FilterState()
        pending: dict[int, Pending] = {}

        def steps() -> Iterator[Iterator[mcl.Located]]:
            for event in self.log.events(self.start):
                measured = self._measure(event, pending)
                yield mcl.step(filter_, state, measured, self.rng)
            yield mcl.finish(filter_, state, self.rng)

        for located_frames in steps():
            for located, milliseconds in timed(located_frames):
                frame = pending.pop(located.t_ns)
                frame.stage_ms["filter"] = milliseconds
                self._hand_over(located, frame)
                progress()
                stop_if_asked()

    def _measure(self, event: Event, pending: dict[int, Pending]) -> mcl.Event:
        """Return the event with its image turned into edges."""
        if isinstance(event, mcl.Sighting):
            pending[event.t_ns] = Pending(None, {"load": 0.0, "edges": 0.0})
        if not isinstance(event, ImageEvent):
            return event
        begin = perf_counter()
        image, encoded = event.load(), event.encoded()
        loaded = perf_counter()
        edges = find_edges(image, self.log.camera, self.config.edges)
        found = perf_counter()
        pending[event.t_ns] = Pending(encoded, {"load": 1e3 * (loaded - begin), "edges": 1e3 * (found - loaded)})
        return mcl.Sighting(event.t_ns, edges)

    def _hand_over(self, located: mcl.Located, pending: Pending) -> None:
        truth = self.log.groundtruth
        true_pose = truth.at(located.t_ns) if truth is not None and truth.covers(located.t_ns) else None
        matches = self.observation.associate(located.estimate.pose, located.edges, self.landmark_map)
        begin = perf_counter()
        for sink in self.sinks:
            sink.frame(LocatedFrame(located, matches, pending.image, true_pose, pending.stage_ms))
        stage_ms = pending.stage_ms | {"sinks": 1e3 * (perf_counter() - begin)}
        for stage in STAGES:
            self.timing[stage].append(stage_ms[stage])

    def _end_early(self, reason: str, exit_code: int) -> RunEndedEarlyError:
        """Save what was done and return the error that says how much that is and where."""
        close_all(self.sinks, complete=False)
        done, frames = len(self.history.frames), len(self.log.frames)
        if done:
            self._write_figures(complete=False)
        return RunEndedEarlyError(
            f"{reason}. The run ended after {done} of {frames} frames; what was done is in {self.folder.path}",
            exit_code,
        )

    def _write_config(self) -> None:
        self.folder.write_text("config.yaml", to_yaml(in_force(self.config)))

    def _write_figures(self, complete: bool) -> dict[str, Any]:
        from localiser.evaluate.report import save_report

        track = self.history.track
        truth = self.log.groundtruth
        if truth is not None and not any(truth.covers(int(t_ns)) for t_ns in track.t_ns):
            truth = None  # a run that ended before the truth begins
        edges = [frame.located.edges for frame in self.history.frames]
        bound = self._bound(track)
        figures = evaluate.metrics(
            track,
            truth,
            log=self.log.name,
            observation=self.config.observation.kind,
            seed=self.config.seed,
            particles=self.config.mcl.particles,
            bound=bound,
            sighted=_sighted(edges),
        )
        figures["complete"] = complete
        figures |= mount_figures(self.log, edges, track.odometry, self.config)
        timing = evaluate.timing_metrics(self.timing)
        self.folder.write_json("metrics.json", figures | timing)
        self.folder.write_json("timing.json", timing)
        save_report(
            self.folder.path / "report.png",
            track,
            figures,
            truth=truth,
            landmark_map=self.landmark_map,
            bound=bound,
        )
        return figures | timing

    def _bound(self, track: evaluate.Track) -> Array | None:
        """Return the posterior Cramér-Rao bound (T, 3, 3), where the log tells true poses and associations."""
        truth, config = self.log.groundtruth, self.config
        located = [frame.located for frame in self.history.frames]
        if truth is None or _sighted([result.edges for result in located]) is None:
            return None
        if self.landmark_map is not self.log.landmark_map:
            return None  # the log's associations are those of its own map
        poses = truth.sampled(track.t_ns).poses
        steps = zip(poses[:-1], located[1:], strict=True)
        moves = [motion.linearised(pose, result.increment, config.motion) for pose, result in steps]
        informations = [
            evaluate.bearing_information(
                pose, self.log.camera, self.landmark_map.points, result.edges, config.observation.kind
            )
            for pose, result in zip(poses, located, strict=True)
        ]
        return evaluate.posterior_bound(
            self.start.cov,
            np.array([jac for jac, _ in moves]).reshape(-1, 3, 3),
            np.array([noise for _, noise in moves]).reshape(-1, 3, 3),
            np.array(informations),
        )


def prepare(
    log: Log, landmark_map: LandmarkMap, config: Config, outputs: Outputs, start_option: str | None = None
) -> Replay:
    """Return a replay of `log` on the map, its folder made and its sinks open. start_option: see `start_of`.

    Raises InputError when camera and observation do not fit, OutputError when results cannot be written.
    """
    if config.observation.kind == "slope" and abs(np.sin(log.camera.mount.tilt_rad)) < np.sin(np.deg2rad(0.1)):
        raise camera_error(
            log.path,
            ("mount", "tilt_deg"),
            "the observation `slope` needs a tilted camera, found a tilt of "
            f"{np.rad2deg(log.camera.mount.tilt_rad):g}°: without tilt every vertical edge is vertical in the image; "
            "use --observation line",
        )
    if config.increments.source != "wheel" and not log.has_images:
        raise InputError(
            f"`--odometry {config.increments.source}` follows edges from image to image, found a log without images: "
            "bearings alone tell neither how far the robot went nor which edge is which; use --odometry wheel",
            path=log.path,
            field="images",
        )
    rng = np.random.default_rng(config.seed)
    start = start_of(log, start_option, rng)
    observation = EdgeObservation(log.camera, config.observation)
    observation.warm_up()
    folder = RunFolder.create(outputs.results, log.name)
    history = History()
    sinks: list[Sink] = [history, TrackWriter(folder.path)]
    context = view.Context(log.name, log.camera, landmark_map, truth=log.groundtruth, images=log.has_images)
    if outputs.rrd:
        sinks.append(view.RrdFile(folder.path / "run.rrd", context))
    live = view.LiveView(outputs.view, context) if outputs.view != "none" else None
    if live is not None:
        sinks.append(live)
    return Replay(log, landmark_map, config, start, rng, observation, folder, history, sinks, live)


def _sighted(all_edges: Sequence[Edges]) -> NDArray[np.bool_] | None:
    """Return whether (T,) a landmark was seen, where the log tells which; None where it does not."""
    if not any((edges.landmark_id >= 0).any() for edges in all_edges):
        return None
    return np.array([(edges.landmark_id >= 0).any() for edges in all_edges])


def timed(items: Iterator[mcl.Located]) -> Iterator[tuple[mcl.Located, float]]:
    """Yield each item with the milliseconds that it took to come."""
    while True:
        begin = perf_counter()
        item = next(items, None)
        if item is None:
            return
        yield item, 1e3 * (perf_counter() - begin)
