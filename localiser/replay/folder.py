"""A replay whose results go into a folder: which sinks there are, and what is written in the end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from localiser import evaluate
from localiser.config import in_force, to_yaml
from localiser.errors import LocaliserError, OutputError, RunEndedEarlyError
from localiser.evaluate import WorstMoments, write_report
from localiser.replay.bag import ReplayBag
from localiser.replay.figures import bound_of, described, run_metrics, truth_of
from localiser.replay.run import Replay, Sink, all_of, close_all
from localiser.replay.start import Stop, asked_to_stop
from localiser.storage import RunFolder, TrackWriter
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


def sinks_of(outputs: Outputs, folder: Path, context: Context) -> list[Sink]:
    """Return the sinks that were asked for, open. Raises OutputError."""
    return [sink for make in SINKS if (sink := make(outputs, folder, context)) is not None]


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
            self.folder.write_text("config.yaml", to_yaml(in_force(self.replay.localiser.config), ["live"]))
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
