"""Logs frames to a Rerun stream; whoever makes the stream decides where they go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import timedelta
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from localiser import geometry
from localiser.errors import OutputError
from localiser.filter import Image, Located, LocatedFrame
from localiser.geometry import Array
from localiser.view import image as image_view
from localiser.view import palette, paths, world
from localiser.view.context import Context
from localiser.view.layout import blueprint

CHUNK_BYTES = 1 << 20
"""What is gathered before it is passed on, about ten frames: what a crash would lose of a file."""

_EPOCH_LIKELY_NS = 10**18
"""2001-09-09 as Unix time: times from here on are dates, smaller ones count from the start of the log."""


def new_stream(context: Context) -> rr.RecordingStream:
    """Return a stream without a sink whose content depends on nothing but what is logged: no wall clock.

    A viewer shows all recordings of one application in the layout that came last. Rows are gathered into chunks by
    size, not by time; the default of five ticks a second also makes small chunks.
    """
    batches = rr.ChunkBatcherConfig(flush_tick=timedelta(days=1), flush_num_bytes=CHUNK_BYTES)
    stream = rr.RecordingStream(context.application, send_properties=False, batcher_config=batches)
    stream.send_recording_name(context.name)
    stream.set_log_time_enabled(False)
    return stream


def stream_to_file(path: Path, context: Context, layout: rrb.Blueprint | None = None) -> rr.RecordingStream:
    """Return a stream into a new `.rrd` file, its layout with it. Raises OutputError where it cannot be written."""
    stream = new_stream(context)
    try:
        stream.save(path, default_blueprint=layout or blueprint(context))
    except (OSError, RuntimeError) as error:
        raise OutputError(f"{path}: cannot be written: {error}") from error
    return stream


SHOWN = 0.02
"""The weight from which on a place where the robot may be is drawn."""

_TEXT_LEVELS = {"WARNING": rr.TextLogLevel.WARN}


class Recorder:
    """Knows what a frame looks like in Rerun, and the little that a frame needs of the one before."""

    def __init__(self, stream: rr.RecordingStream, context: Context) -> None:
        self._stream = stream
        self._context = context
        self._ends = context.landmark_ends
        self._number, self._t_ns = 0, 0
        self._trails: dict[str, Array] = {}
        self._map_from_odometry: Array | None = None
        self._stages: tuple[str, ...] = ()
        self._reason = ""
        self._log_static()

    def frame(self, number: int, frame: LocatedFrame) -> None:
        """Log one frame, the `number`th of its run."""
        located, matches, truth = frame.located, frame.matches, frame.truth
        self._number = number
        self._set_time(located.t_ns)
        self._log_map(located.estimate.pose, matches.landmark, matches.visible)
        self._log_poses(located, truth)
        if self._context.images:
            self._log_image(located, frame.image, matches.landmark, matches.visible)
        self._log_confidence(located)
        self._log_plots(located, truth, int((matches.landmark >= 0).sum()), frame.stage_ms)

    def message(self, t_ns: int, text: str, level: str = "INFO") -> None:
        """Log a line of text beside the last frame; level is one of Python's, such as INFO or WARNING."""
        self._set_time(t_ns)
        self._stream.log(paths.TEXT, rr.TextLog(text, level=_TEXT_LEVELS.get(level.upper(), level.upper())))

    def end(self, complete: bool) -> None:
        """Log that the run ended, and whether it got to the end of its log."""
        text, level = ("run complete", "INFO") if complete else ("run ended early", "WARNING")
        self.message(self._t_ns, text, level)

    # -- parts of a frame ---------------------------------------------------------------------------------------

    def _set_time(self, t_ns: int) -> None:
        self._t_ns = t_ns
        set_time(self._stream, self._number, t_ns)

    def _log_map(self, pose: Array, landmark: NDArray[np.int64], visible: NDArray[np.bool_]) -> None:
        matched = np.unique(landmark[landmark >= 0])
        expected = visible.copy()
        expected[matched] = False
        self._stream.log(paths.VISIBLE, world.landmarks(self._ends[expected], palette.VISIBLE, 2.0))
        self._stream.log(paths.MATCHED, world.landmarks(self._ends[matched], palette.MATCHED, 3.0))
        points = self._context.landmark_map.points[matched]
        self._stream.log(paths.SIGHTS, world.sights(self._context.camera, pose, points))

    def _log_poses(self, located: Located, truth: Array | None) -> None:
        estimate = located.estimate
        if len(located.particles):  # not of a frame that was located before the run was resumed
            self._stream.log(paths.PARTICLES, world.particles(located.particles))
        self._stream.log(paths.ELLIPSE, world.ellipse(estimate))
        self._stream.log(paths.ESTIMATE, world.arrow(estimate.pose, palette.ESTIMATE, 4.0))
        self._stream.log(paths.CAMERA, world.camera_transform(self._context.camera, estimate.pose))
        self._log_trail(paths.ESTIMATE_TRAIL, estimate.pose, palette.ESTIMATE)
        if truth is not None:
            self._stream.log(paths.TRUTH, world.arrow(truth, palette.TRUTH, 2.5))
            self._log_trail(paths.TRUTH_TRAIL, truth, palette.TRUTH)
        odometry = self._odometry_in_map(located)
        if np.isfinite(odometry).all():
            self._log_trail(paths.ODOMETRY_TRAIL, odometry, palette.ODOMETRY)

    def _log_confidence(self, located: Located) -> None:
        if located.reason != self._reason:
            unsure = f"perhaps lost: {located.reason} (p = {located.p_correct:.2f})"
            found = f"sure of the pose (p = {located.p_correct:.2f})"
            self.message(located.t_ns, unsure if located.reason else found, "WARNING" if located.reason else "INFO")
            self._reason = located.reason
        places = located.clusters
        if places is None or (places.weight >= SHOWN).sum() < 2:  # the estimate's own ellipse says it all
            for path in (paths.PLACES, paths.PLACE_ARROWS):
                self._stream.log(path, rr.Clear(recursive=False))
            return
        shown = places.heaviest(SHOWN)
        self._stream.log(paths.PLACES, world.place_ellipses(shown))
        self._stream.log(paths.PLACE_ARROWS, world.place_arrows(shown))

    def _log_trail(self, path: str, pose: Array, colour: palette.Colour) -> None:
        # Only the newest piece: the layout shows all pieces up to the cursor, so a frame costs the same at the end of a
        # long run as at its start, and a frame that was dropped leaves no gap.
        start = self._trails.get(path, pose)
        self._trails[path] = pose
        self._stream.log(path, world.trail(np.stack([start[:2], pose[:2]]), colour))

    def _odometry_in_map(self, located: Located) -> Array:
        if self._context.odometry is not None:
            return self._context.odometry.at(located.t_ns)
        if self._map_from_odometry is None and np.isfinite(located.odometry).all():
            self._map_from_odometry = geometry.compose(
                located.estimate.pose, geometry.between(located.odometry, np.zeros(3))
            )
        if self._map_from_odometry is None:
            return np.full(3, np.nan)
        return geometry.compose(self._map_from_odometry, located.odometry)

    def _log_image(
        self, located: Located, image: Image | None, landmark: NDArray[np.int64], visible: NDArray[np.bool_]
    ) -> None:
        edges, pose = located.edges, located.estimate.pose
        # Without an image the last one would stay on the screen under the new edges.
        self._stream.log(paths.IMAGE, rr.Clear(recursive=False) if image is None else image_view.picture(image))
        shown, lines = image_view.predicted_lines(self._context.camera, pose, self._ends, visible)
        self._stream.log(paths.REJECTED, image_view.rejected(edges))
        self._stream.log(paths.PREDICTED, image_view.predicted(lines))
        self._stream.log(paths.EDGES, image_view.vertical_edges(edges, landmark >= 0))
        self._stream.log(paths.JOINS, image_view.joins(edges, landmark, shown, lines))

    def _log_plots(self, located: Located, truth: Array | None, matched: int, stage_ms: Mapping[str, float]) -> None:
        estimate = located.estimate
        three_sigma = 3 * float(np.sqrt(np.trace(estimate.pose_cov[:2, :2])))
        three_sigma_rad = 3 * float(np.sqrt(estimate.pose_cov[2, 2]))
        error = np.nan if truth is None else float(np.hypot(*(estimate.pose - truth)[:2]))
        error_rad = np.nan if truth is None else abs(float(geometry.wrap_angle(estimate.pose[2] - truth[2])))
        self._stream.log(paths.ERROR, rr.Scalars([error, three_sigma]))
        self._stream.log(paths.HEADING, rr.Scalars(np.rad2deg([error_rad, three_sigma_rad])))
        self._stream.log(paths.P_CORRECT, rr.Scalars([located.p_correct]))
        self._stream.log(paths.ESS, rr.Scalars([located.ess]))
        self._stream.log(paths.COUNTS, rr.Scalars([len(located.edges), matched]))
        if not self._stages and stage_ms:
            self._stages = tuple(stage_ms)
            self._log_series(paths.STAGES, self._stages, palette.STAGES)
        self._stream.log(paths.STAGES, rr.Scalars([stage_ms.get(stage, np.nan) for stage in self._stages]))

    # -- once ---------------------------------------------------------------------------------------------------

    def _log_static(self) -> None:
        log, context = self._stream.log, self._context
        log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
        log(paths.LANDMARKS, world.landmarks(self._ends, palette.UNSEEN, 1.2), static=True)
        log(paths.CAMERA, world.pinhole(context.camera), rr.TransformAxes3D(0.0), static=True)
        if context.truth is not None:
            log(paths.TRUTH_PATH, world.trail(context.truth.poses[:, :2], palette.TRUTH_AHEAD, 1.2), static=True)
        errors = (palette.ESTIMATE, palette.UNSEEN)
        self._log_series(paths.ERROR, ("error", "3σ"), errors)
        self._log_series(paths.HEADING, ("error", "3σ"), errors)
        self._log_series(paths.P_CORRECT, ("p correct",), (palette.ESTIMATE,))
        self._log_series(paths.ESS, ("effective particles",), (palette.ESTIMATE,))
        self._log_series(paths.COUNTS, ("edges", "matched"), (palette.UNMATCHED, palette.MATCHED))

    def _log_series(self, path: str, names: Sequence[str], colours: Sequence[palette.Colour]) -> None:
        self._stream.log(path, series(names, colours), static=True)


def set_time(stream: rr.RecordingStream, number: int, t_ns: int) -> None:
    """Set what is logged from now on, on this thread, to the `number`th frame and its time."""
    # Rerun keeps the time per thread: set it where it is used.
    stream.set_time(paths.FRAME, sequence=number)
    if t_ns >= _EPOCH_LIKELY_NS:
        stream.set_time(paths.TIME, timestamp=np.datetime64(t_ns, "ns"))
    else:
        stream.set_time(paths.TIME, duration=np.timedelta64(t_ns, "ns"))


def series(names: Sequence[str], colours: Sequence[palette.Colour]) -> rr.SeriesLines:
    """Return how the lines of a plot are called and coloured; colours repeat."""
    return rr.SeriesLines(names=names, colors=list(islice(cycle(colours), len(names))), widths=[1.5] * len(names))
