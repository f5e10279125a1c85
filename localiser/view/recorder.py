"""Log frames of a run to a Rerun stream. Its maker decides where the stream goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import timedelta
from itertools import cycle, islice
from typing import Any

import numpy as np
import rerun as rr

from localiser import geometry
from localiser.filter import Located, LocatedFrame
from localiser.geometry import Array
from localiser.landmarks import predicted_lines
from localiser.particles import only
from localiser.view import draw, palette, paths
from localiser.view.paths import Context

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
    stream = rr.RecordingStream("localiser", send_properties=False, batcher_config=batches)
    stream.send_recording_name(context.name)
    stream.set_log_time_enabled(False)
    return stream


SHOWN = 0.02
"""The weight from which on a place where the robot may be is drawn."""

MOST_LANDMARKS = 3000
"""Of a larger map points on the floor stand for the landmarks: tens of thousands of lines make a viewer slow. Those
that the camera should see are lines all the same."""

_TEXT_LEVELS = {"WARNING": rr.TextLogLevel.WARN}


class Recorder:
    """Knows what a frame looks like in Rerun, and the little that a frame needs of the one before."""

    def __init__(self, stream: rr.RecordingStream, context: Context) -> None:
        self._stream = stream
        self._context = context
        self._map_name = ""  # of several maps the one that is shown
        self._ends, self._points = context.landmark_ends, context.landmark_map.points
        self._number, self._t_ns = 0, 0
        self._trails: dict[str, Array] = {}
        self._map_from_odometry: Array | None = None
        self._stages: tuple[str, ...] = ()
        self._reason, self._warning = "", ""
        self._log_static()

    def frame(self, number: int, frame: LocatedFrame) -> None:
        """Log one frame, the `number`th of its run."""
        self._number = number
        self._set_time(frame.located.t_ns)
        if frame.map_name != self._map_name:
            self._change_map(frame.map_name)
        self._log_map(frame)
        self._log_poses(frame)
        if self._context.images:
            self._log_image(frame)
        self._log_confidence(frame.located)
        self._log_plots(frame)

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

    def _change_map(self, name: str) -> None:
        """Show another of several maps: the one that the robot is believed to be on."""
        shown = self._context.landmark_map.seen_on(name)
        self._map_name, self._points = name, shown.points
        self._ends = replace(self._context, landmark_map=shown).landmark_ends
        self._map_from_odometry = None
        self._trails.clear()
        for path in (paths.LANDMARKS, *paths.TRAILS):
            self._stream.log(path, rr.Clear(recursive=False))
        self._log_landmarks(static=False)
        self.message(self._t_ns, f"the map is {name}")

    def _log_landmarks(self, *, static: bool) -> None:
        """Draw the landmarks of the map that is believed, of a large one only where some are."""
        here = self._context.landmark_map.is_on(self._map_name, self._points)
        is_large = len(self._ends) > MOST_LANDMARKS
        of_all = draw.coarse(self._points[here]) if is_large else draw.landmarks(self._ends[here], palette.UNSEEN, 2.4)
        self._stream.log(paths.LANDMARKS, of_all, static=static)

    def _log_map(self, frame: LocatedFrame) -> None:
        landmark, pose = frame.matches.landmark, frame.located.estimate.pose
        matched = np.unique(landmark[landmark >= 0])
        expected = frame.matches.visible.copy()
        expected[matched] = False
        self._stream.log(paths.VISIBLE, draw.landmarks(self._ends[expected], palette.VISIBLE, 3.5))
        self._stream.log(paths.MATCHED, draw.landmarks(self._ends[matched], palette.MATCHED, 4.5))
        points = self._points[matched]
        self._stream.log(paths.SIGHTS, draw.sights(self._context.camera.at(frame.located.edges.mount), pose, points))

    def _log_poses(self, frame: LocatedFrame) -> None:
        located, truth = frame.located, frame.truth
        estimate = located.estimate
        if len(located.particles):  # not of a frame that was located before the run was resumed
            here = self._context.landmark_map.is_on(self._map_name, located.particles.poses)
            shown = located.particles if here.all() else only(located.particles, here)
            self._stream.log(paths.PARTICLES, draw.particles(shown))
        self._stream.log(paths.ELLIPSE, draw.ellipse(estimate))
        self._stream.log(
            paths.ESTIMATE, draw.arrow(estimate.pose, palette.ESTIMATE if frame.is_found else palette.NOT_FOUND, 5.0)
        )
        self._stream.log(
            paths.CAMERA, draw.camera_transform(self._context.camera.at(located.edges.mount), estimate.pose)
        )
        if frame.is_found:  # else the trail would cross the building
            self._log_trail(paths.ESTIMATE_TRAIL, estimate.pose, palette.ESTIMATE)
        else:
            self._trails.pop(paths.ESTIMATE_TRAIL, None)
        if truth is not None:
            self._stream.log(paths.TRUTH, draw.arrow(truth, palette.TRUTH, 2.5))
            self._log_trail(paths.TRUTH_TRAIL, truth, palette.TRUTH)
        if np.isfinite(located.odometry).all():
            if self._map_from_odometry is None and frame.is_found:
                origin = geometry.between(located.odometry, np.zeros(3))
                self._map_from_odometry = geometry.compose(estimate.pose, origin)
            if self._map_from_odometry is not None:
                odometry = geometry.compose(self._map_from_odometry, located.odometry)
                self._log_trail(paths.ODOMETRY_TRAIL, odometry, palette.ODOMETRY)

    def _log_confidence(self, located: Located) -> None:
        if located.reason != self._reason:
            self._reason = located.reason
            text, level = (f"perhaps lost: {self._reason}", "WARNING") if self._reason else ("sure of the pose", "INFO")
            self.message(located.t_ns, f"{text} (p = {located.p_correct:.2f})", level)
        if located.warning != self._warning:
            self._warning = located.warning
            self.message(located.t_ns, self._warning or "the map fits again", "WARNING" if self._warning else "INFO")
        places = located.clusters
        likely = places.weight >= SHOWN if places else np.zeros(0, dtype=bool)
        here = likely & self._context.landmark_map.is_on(self._map_name, places.mean) if places else likely
        if not places or likely.sum() < 2 or not here.any():  # the estimate's own ellipse says it all
            for path in (paths.PLACES, paths.PLACE_ARROWS):
                self._stream.log(path, rr.Clear(recursive=False))
            return
        shown = replace(places, weight=places.weight[here], mean=places.mean[here], cov=places.cov[here])
        self._stream.log(paths.PLACES, draw.place_ellipses(shown))
        self._stream.log(paths.PLACE_ARROWS, draw.place_arrows(shown))

    def _log_trail(self, path: str, pose: Array, colour: palette.Colour) -> None:
        # Only the newest piece: the layout shows all pieces up to the cursor, so a frame costs the same at the end of a
        # long run as at its start, and a frame that was dropped leaves no gap.
        start = self._trails.get(path, pose)
        self._trails[path] = pose
        self._stream.log(path, draw.trail(np.stack([start[:2], pose[:2]]), colour))

    def _log_image(self, frame: LocatedFrame) -> None:
        log, edges, matches = self._stream.log, frame.located.edges, frame.matches
        # Without an image the last one would stay on the screen under the new edges.
        log(paths.IMAGE, rr.Clear(recursive=False) if frame.image is None else draw.picture(frame.image))
        pose = frame.located.estimate.pose
        shown, lines = predicted_lines(self._context.camera.at(edges.mount), pose, self._ends, matches.visible)
        log(paths.REJECTED, draw.rejected(edges))
        log(paths.PREDICTED, draw.predicted(lines))
        log(paths.EDGES, draw.vertical_edges(edges, matches.landmark >= 0))
        log(paths.JOINS, draw.joins(edges, matches.landmark, shown, lines))

    def _log_plots(self, frame: LocatedFrame) -> None:
        located, truth, stage_ms = frame.located, frame.truth, frame.stage_ms
        estimate, matched = located.estimate, int((frame.matches.landmark >= 0).sum())
        cov = frame.pose_cov
        error = np.full(3, np.nan) if truth is None else estimate.pose - truth
        turn_deg = np.rad2deg([abs(float(geometry.wrap_angle(error[2]))), 3 * float(np.sqrt(cov[2, 2]))])
        if not self._stages and stage_ms:
            self._stages = tuple(stage_ms)
            self._stream.log(paths.STAGES, series(self._stages, palette.STAGES), static=True)
        figures: dict[str, Any] = {
            paths.ERROR: [float(np.hypot(*error[:2])), 3 * float(np.sqrt(np.trace(cov[:2, :2])))],
            paths.HEADING: turn_deg,
            paths.P_CORRECT: [located.p_correct],
            paths.ESS: [located.ess],
            paths.COUNTS: [len(located.edges), matched],
            paths.STAGES: [stage_ms.get(stage, np.nan) for stage in self._stages],
        }
        for path, values in figures.items():
            self._stream.log(path, rr.Scalars(values))

    # -- once ---------------------------------------------------------------------------------------------------

    def _log_static(self) -> None:
        log, context = self._stream.log, self._context
        log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
        if len(context.landmark_map.maps) == 1:
            self._log_landmarks(static=True)
        log(paths.CAMERA, draw.pinhole(context.camera), rr.TransformAxes3D(0.0), static=True)
        if context.truth is not None:
            log(paths.TRUTH_PATH, draw.trail(context.truth.poses[:, :2], palette.TRUTH_AHEAD, 1.2), static=True)
        errors = (("error", "3σ"), (palette.ESTIMATE, palette.UNSEEN))
        lines: dict[str, tuple[Sequence[str], Sequence[palette.Colour]]] = {
            paths.ERROR: errors,
            paths.HEADING: errors,
            paths.P_CORRECT: (("p correct",), (palette.ESTIMATE,)),
            paths.ESS: (("effective particles",), (palette.ESTIMATE,)),
            paths.COUNTS: (("edges", "matched"), (palette.UNMATCHED, palette.MATCHED)),
        }
        for path, (names, colours) in lines.items():
            log(path, series(names, colours), static=True)


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
