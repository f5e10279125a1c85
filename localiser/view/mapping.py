"""A map as it is built: image and tracks, landmarks with shrinking ellipses, the path before and after loops closed."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.documents import draft_beside, output_errors, remove
from localiser.edges import Edges
from localiser.filter import Image
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.view import live, paths
from localiser.view.context import Context
from localiser.view.paths import WORLD

if TYPE_CHECKING:
    import rerun as rr

PLACES, ELLIPSES = f"{WORLD}/building/landmarks", f"{WORLD}/building/ellipses"
BEFORE, AFTER = f"{WORLD}/trails/before_loops", f"{WORLD}/trails/after_loops"
TAILS = f"{paths.OVERLAY}/tracks"
LANDMARKS, SIGMA, TRACKS = "plots/landmarks", "plots/sigma", "plots/tracks"
QUEUE_FRAMES = 500
"""What a viewer may lag behind: building from edges that are known already is faster than a viewer starts."""

_TITLES = {LANDMARKS: "Landmarks", SIGMA: "Their 1σ, cm", paths.COUNTS: "Edges", TRACKS: "Tracks"}
_MARGIN_M = 1.5  # around the path: walls stand beside it
_LARGEST_M = 1.0  # an ellipse beyond this would cover everything and say nothing
_TAIL = 15  # images that a track is drawn through
_CIRCLE = np.stack([np.cos(np.linspace(0, 2 * np.pi, 33)), np.sin(np.linspace(0, 2 * np.pi, 33))], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Growing:
    """One image and what is known after it.

    pose: (3,) of the robot. feature, is_landmark: (E,) which track each edge belongs to, and whether that is a landmark
    by now. points, cov: (L, 2), (L, 2, 2) of the landmarks. shown: (M,) those that this image shows.
    """

    t_ns: int
    pose: Array
    image: Image | None
    edges: Edges
    feature: NDArray[np.int64]
    is_landmark: NDArray[np.bool_]
    points: Array
    cov: Array
    shown: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """The map in the end, and the robot's path; before: the same with no loop closed, where loops were looked for."""

    landmark_map: LandmarkMap
    path: Trajectory
    before: Trajectory | None
    text: str


class MapFile:
    """Writes the building of a map to a `.rrd` file, if a map comes out. Raises OutputError where it cannot be written.

    Until then the recording has a name of its own: a build that is refused leaves what was there before.
    """

    def __init__(self, path: Path, context: Context) -> None:
        from localiser.view.recorder import new_stream
        from localiser.view.recording_file import RecordingFile

        self._path, self._draft = path, draft_beside(path)
        stream = new_stream(context)
        self._file = RecordingFile(self._draft, stream, _layout(context), becomes=path)
        self._recorder = _Recorder(stream, context)
        self._finished = False

    def frame(self, frame: Growing) -> None:
        """Write one image and what is known after it."""
        self._recorder.frame(frame)

    def finish(self, finished: Finished) -> None:
        """Write what came out."""
        self._recorder.finish(finished)
        self._finished = True

    def close(self) -> None:
        """End the file, which can be opened from now on, or drop it when nothing came out."""
        try:
            self._file.end()
            if self._finished:
                with output_errors(self._path):
                    self._draft.replace(self._path)
        finally:
            remove(self._draft)


class MapView(live.Feed["_Recorder"]):
    """Shows the building of a map in a viewer, native or in the browser; see `Feed`."""

    def __init__(self, kind: live.Kind, context: Context, **how: Any) -> None:
        super().__init__(kind, context, lambda stream: _begun(stream, context), **{"queue_frames": QUEUE_FRAMES, **how})

    def frame(self, frame: Growing) -> None:
        """Show one image and what is known after it."""
        self.draw(lambda recorder: recorder.frame(frame))

    def finish(self, finished: Finished) -> None:
        """Show what came out."""
        self.draw(lambda recorder: recorder.finish(finished))

    def close(self) -> None:
        """End the stream; waits a moment for a viewer that is behind, and leaves it running."""
        self.end()


def building_context(name: str, camera: Camera, path: Trajectory, *, images: bool) -> Context:
    """Return what a view of a map must know that is yet to be built: the path (T, 3) that it is built along."""
    nothing = LandmarkMap.from_points(np.zeros((0, 2)))
    return Context(name, camera, nothing, truth=path, images=images, application="localiser map build")


def _layout(context: Context) -> Any:
    from localiser.view.layout import blueprint

    return blueprint(context, _TITLES, margin_m=_MARGIN_M)


def _begun(stream: rr.RecordingStream, context: Context) -> _Recorder:
    stream.send_blueprint(_layout(context))
    return _Recorder(stream, context)


@dataclass(slots=True, eq=False)
class _Tails:
    """Where the edges of each track were in the last images: feature to lines of two ends (u, v)."""

    lines: dict[int, list[Array]] = field(default_factory=dict)

    def add(self, edges: Edges, feature: NDArray[np.int64]) -> list[Array]:
        """Take in one image; return how far the tracks that it shows came, each (2 to `_TAIL`, 2) in one pixel row."""
        seen = {int(f): ends for f, ends in zip(feature, edges.ends_px, strict=True) if np.isfinite(ends).all()}
        self.lines = {f: [*self.lines.get(f, []), ends][-_TAIL:] for f, ends in seen.items()}
        return [_in_one_row(np.array(lines)) for lines in self.lines.values() if len(lines) > 1]


def _in_one_row(lines: Array) -> Array:
    """Return where lines (K, 2, 2) cross the pixel row (K, 2) of the last one's middle: where edges end is chance."""
    bottom, top = lines[:, 0], lines[:, 1]
    v = lines[-1, :, 1].mean()
    along = (v - bottom[:, 1]) / np.minimum(top[:, 1] - bottom[:, 1], -1.0)
    return np.stack([bottom[:, 0] + along * (top - bottom)[:, 0], np.full(len(lines), v)], axis=-1)


class _Recorder:
    """Knows what the building of a map looks like in Rerun."""

    def __init__(self, stream: rr.RecordingStream, context: Context) -> None:
        import rerun as rr

        from localiser.view import palette, world
        from localiser.view.recorder import series

        self._stream, self._context, self._tails = stream, context, _Tails()
        self._number, self._t_ns, self._newest = -1, 0, -1
        self._last: Array | None = None
        log = stream.log
        log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
        log(paths.CAMERA, world.pinhole(context.camera), rr.TransformAxes3D(0.0), static=True)
        log(LANDMARKS, series(("landmarks",), (palette.VISIBLE,)), static=True)
        log(SIGMA, series(("median", "90 % below"), (palette.MATCHED, palette.UNSEEN)), static=True)
        log(TRACKS, series(("followed", "begun"), (palette.VISIBLE, palette.JOIN)), static=True)
        log(paths.COUNTS, series(("all", "of landmarks"), (palette.UNMATCHED, palette.MATCHED)), static=True)

    def frame(self, frame: Growing) -> None:
        """Log one image and what is known after it."""
        import rerun as rr

        from localiser.view import image as image_view
        from localiser.view import palette, world

        self._next(frame.t_ns)
        log, pose = self._stream.log, frame.pose
        last = pose if self._last is None else self._last
        self._last = pose
        log(paths.CAMERA, world.camera_transform(self._context.camera, pose))
        log(paths.ESTIMATE, world.arrow(pose, palette.ESTIMATE, 4.0))
        log(paths.ESTIMATE_TRAIL, world.trail(np.stack([last[:2], pose[:2]]), palette.ESTIMATE))
        if self._context.images:
            log(paths.IMAGE, rr.Clear(recursive=False) if frame.image is None else image_view.picture(frame.image))
        log(paths.EDGES, image_view.vertical_edges(frame.edges, frame.is_landmark))
        tails = self._tails.add(frame.edges, frame.feature)
        log(TAILS, rr.LineStrips2D(tails, colors=palette.JOIN, radii=rr.Radius.ui_points(0.7)))
        self._log_landmarks(LandmarkMap.from_points(frame.points), frame.cov)
        log(paths.SIGHTS, world.sights(self._context.camera, pose, frame.points[frame.shown]))
        log(paths.COUNTS, rr.Scalars([len(frame.edges), int(frame.is_landmark.sum())]))
        begun = int((frame.feature > self._newest).sum())
        log(TRACKS, rr.Scalars([len(frame.edges) - begun, begun]))
        self._newest = int(frame.feature.max(initial=self._newest))

    def finish(self, finished: Finished) -> None:
        """Log the map in the end, and the path with loops closed over the one without."""
        import rerun as rr

        from localiser.view import palette, world

        self._next(self._t_ns)
        log, made = self._stream.log, finished.landmark_map
        self._log_landmarks(made, made.cov)
        log(paths.SIGHTS, rr.Clear(recursive=False))
        if finished.before is not None:
            log(BEFORE, world.trail(finished.before.poses[:, :2], palette.ODOMETRY, 1.2))
            log(AFTER, world.trail(finished.path.poses[:, :2], palette.TRUTH, 2.0))
        log(paths.TEXT, rr.TextLog(finished.text, level=rr.TextLogLevel.INFO))

    def _next(self, t_ns: int) -> None:
        from localiser.view.recorder import set_time

        self._number, self._t_ns = self._number + 1, t_ns
        set_time(self._stream, self._number, t_ns)

    def _log_landmarks(self, known: LandmarkMap, cov: Array) -> None:
        import rerun as rr

        from localiser.view import palette, world

        log = self._stream.log
        ends = Context("", self._context.camera, known).landmark_ends
        log(PLACES, world.landmarks(ends, palette.MATCHED, 1.5))
        log(ELLIPSES, ellipses(known.points, cov))
        log(LANDMARKS, rr.Scalars([len(cov)]))
        if len(cov):
            sigma_cm = 100 * np.sqrt(np.trace(cov, axis1=1, axis2=2) / 2)
            log(SIGMA, rr.Scalars(np.quantile(sigma_cm, (0.5, 0.9)).tolist()))


def ellipses(points: Array, cov: Array) -> rr.LineStrips3D:
    """Return the 95 % ellipses of landmarks, those that are worse than a metre left out."""
    import rerun as rr

    from localiser.view import palette, world

    variance, axes = np.linalg.eigh(cov)
    half = np.sqrt(world.CHI2_95_2D * np.maximum(variance, 0.0))
    shown = half[:, 1] < _LARGEST_M
    scaled = axes[shown] * half[shown, None, :]
    lines = points[shown, None] + np.einsum("kij,cj->kci", scaled, _CIRCLE)
    return rr.LineStrips3D(
        world.at_height(lines, 0.02).astype(np.float32), colors=palette.VISIBLE, radii=rr.Radius.ui_points(0.8)
    )
