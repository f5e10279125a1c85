"""Replay a log: pass its measurements to a localiser in the order of time, and the results to every sink."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from localiser.config import Config, read_config, with_seed
from localiser.edges import Detector, light_of
from localiser.errors import InputError
from localiser.filter import Anywhere, LocatedFrame, Odometry, Sighting, Start
from localiser.geometry import compose, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.localiser import Localiser, MeasuredImage, check_settings
from localiser.mapping import start_on_map
from localiser.motion import MotionModel
from localiser.observation import Observation
from localiser.replay.figures import STAGES, Results
from localiser.replay.frames import in_order
from localiser.storage import ImageEvent, Log, camera_error, checkpoint_of, open_log, read_maps, require_odometry

LIT_EVERY = 5  # images, of which one is looked at for its light


class Sink(Protocol):
    """Takes what was located, image by image: files, recordings, live views."""

    def frame(self, frame: LocatedFrame) -> None:
        """Take one frame."""

    def close(self, complete: bool) -> None:
        """End. complete: whether the whole log was replayed."""


def close_all(sinks: Sequence[Sink], complete: bool) -> None:
    """Close every sink, the later ones also when an earlier one fails; then raise the first failure."""
    all_of([partial(sink.close, complete) for sink in sinks])


def all_of(steps: Iterable[Callable[[], object]]) -> None:
    """Take every step, the later ones also when an earlier one fails; then raise the first failure."""
    failures = []
    for step in steps:
        try:
            step()
        except Exception as failure:
            failures.append(failure)
    if failures:
        raise failures[0]


class Replay(Results):
    """A log that is replayed; `Results` has what was located until now."""

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
        for event, measured in in_order(events, self._measured, lambda event: isinstance(event, ImageEvent), threads):
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
        if true_pose is not None:
            true_pose = true_pose - self.localiser.landmark_map.origin(frame.map_name)
        return replace(frame, located=located, truth=true_pose)

    def _hand_over(self, frame: LocatedFrame, sinks: Sequence[Sink]) -> None:
        begin = perf_counter()
        self.frames.append(frame)
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


# -- where it starts --------------------------------------------------------------------------------------------------

START_SIGMA = np.array([0.1, 0.1, np.deg2rad(3.0)])
"""How far a start that is given on the command line may be off: x, z (m), heading (rad), one sigma."""

FARTHEST = np.array([1e8, 1e8, 2 * np.pi])
"""The largest x, z (m) and heading (rad) that can be given, as in a log's start."""

TRUTH, GLOBAL = "truth", "global"


def start_of(
    log: Log, option: str | Start | None, rng: np.random.Generator, landmark_map: LandmarkMap | None = None
) -> Start | None:
    """Return the start of a replay at its first image; None for anywhere on the map.

    option: a start, `x,z,heading_deg`, `global` for anywhere, `truth` for the true pose plus a draw from
    N(0, `START_SIGMA`²), or None: as the log states, else where it began on a landmark map that was built from it.
    Raises InputError.
    """
    if isinstance(option, Start) or option == GLOBAL:
        return option if isinstance(option, Start) else None
    first_ns = log.frames[0].t_ns
    if option is None:
        maps = () if log.start is not None or landmark_map is None else landmark_map.maps
        for one in maps:
            if landmark_map is not None and (began := start_on_map(one, log)) is not None:
                return stated_start(began + landmark_map.origin(one.name), first_ns)
        return log.start
    if option != TRUTH:
        return stated_start(option, first_ns, landmark_map, f", {GLOBAL} or {TRUTH}")
    if log.groundtruth is None or not log.groundtruth.covers(first_ns):
        raise InputError(
            "--start truth needs the true pose at the first image, which the log does not have; "
            "say where the robot starts with --start x,z,heading_deg, or have it looked for with --start global",
            path=log.path,
            field="start",
        )
    pose = log.groundtruth.at(first_ns) + START_SIGMA * rng.standard_normal(3)
    pose[2] = wrap_angle(pose[2])
    return stated_start(np.asarray(pose), first_ns)


def stated_start(
    pose: str | np.ndarray, t_ns: int = 0, landmark_map: LandmarkMap | None = None, further: str = ""
) -> Start:
    """Return a start at a pose (3,), or at that of `x,z,heading_deg`, to `START_SIGMA`. Raises InputError.

    landmark_map: where that may follow the name of one of several maps and a colon. further: see `given_pose`.
    """
    if isinstance(pose, str):
        name, _, numbers = pose.rpartition(":")
        if name and (landmark_map is None or len(landmark_map.maps) < 2):
            raise InputError(f"expected no name of a map where there is one map, found {pose!r}", field="--start")
        pose = given_pose(numbers, further) + (np.zeros(3) if landmark_map is None else landmark_map.origin(name))
    return Start(t_ns, pose, np.diag(START_SIGMA**2))


def given_pose(option: str, further: str = "") -> np.ndarray:
    """Return the pose (3,) of `x,z,heading_deg`. further: what errors say is taken too. Raises InputError."""
    problem = f"expected x,z,heading_deg (metres and degrees, such as 1.5,-2,90){further}, found {option!r}"
    try:
        x, z, heading_deg = (float(part) for part in option.split(","))
    except ValueError:
        raise InputError(problem, field="--start") from None
    pose = np.array([x, z, np.deg2rad(heading_deg)])
    if not (np.abs(pose) <= FARTHEST).all():
        raise InputError(problem, field="--start")
    pose[2] = wrap_angle(pose[2])
    return pose


# -- the whole way -----------------------------------------------------------------------------------------------------


def prepare(
    log: Log,
    config: Config,
    start: str | Start | None = None,
    *,
    landmark_map: LandmarkMap | None = None,
    map_files: Sequence[Path] = (),
    **own: Any,
) -> Replay:
    """Return a replay of `log` that is ready to run.

    start: see `start_of`. landmark_map, or that in map_files, takes the place of the log's own; of several the first is
    the one that the log's start and truth are on. own: observation, motion and detector, see `Localiser`. Raises
    InputError when the map is missing, or settings, camera and log do not fit.
    """
    if landmark_map is None:
        landmark_map = read_maps(map_files) if map_files else log.landmark_map
    if landmark_map is None:
        raise InputError(
            f"the log has no map; expected --map MAP. `localiser map build {log.path} -o map.yaml` makes "
            "one of the log itself, `localiser map plan` of a floor plan",
            path=log.path,
            field="map",
        )
    if config.increments.source != "vision":
        require_odometry(log, f"`increments.source: {config.increments.source}`")
    has_start = start == TRUTH or start_of(log, start, np.random.default_rng(0), landmark_map) is not None
    try:
        check_settings(
            config,
            log.camera,
            images=log.has_images,
            has_start=has_start,
            own_observation=own.get("observation") is not None,
        )
    except InputError as error:
        if error.field == "mount.tilt_deg":
            raise camera_error(log.path, ("mount", "tilt_deg"), error.problem) from None
        raise InputError(error.problem, path=log.path, field=error.field) from None
    if config.observation.association == "known" and landmark_map is not log.landmark_map:
        log = log.identified_on(landmark_map)
    localiser = Localiser(landmark_map, log.camera, config, **own)
    return Replay(log, localiser, start_of(log, start, localiser.rng, landmark_map), map_files)


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
    landmark_map: in place of the log's own, or several laid apart (`Site.beside`). start: where the robot starts, or
    `x,z,heading_deg`, `truth` or `global` as on the command line; by default as the log states, or a map that was built
    from it, else anywhere. seed: in place of the configuration's. sinks: get every located image, and are closed.
    observation, motion, detector: see `Localiser`. Raises InputError.
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
