"""Watch a map being built: a map that grows image by image as edges are found, then the map that came out."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np
import typer

from localiser import view
from localiser.edges import Edges
from localiser.geometry import Array, Trajectory
from localiser.mapping import LiveMap, MapBuilt, MappingParameters
from localiser.storage import ImageEvent, Log
from localiser.view import Finished, Growing, MapFile, MapView, building_context


class MapWatch:
    """Grows a live map along a path, and hands every step of it to sinks; without sinks it does nothing.

    rrd: a recording to write. kind: of a viewer, see `view.LiveView`, or none. Raises OutputError, InputError.
    """

    def __init__(self, log: Log, parameters: MappingParameters, rrd: Path | None, kind: view.Kind) -> None:
        view.check_kind(kind)
        self._log, self._rrd, self._kind = log, rrd, kind
        self._live = LiveMap(log.camera, parameters)
        self._sinks: list[MapFile | MapView] = []
        self._open = ExitStack()
        self.viewer: MapView | None = None

    def __enter__(self) -> MapWatch:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._open.close()

    def begin(self, path: Trajectory, turn_sigma: Array) -> None:
        """Open the sinks. path: poses (T, 3) as known while driving. turn_sigma: (T,) rad, errors of their turns."""
        self._frames = {frame.t_ns: frame for frame in self._log.frames}
        self._path = path
        self._step_at = {int(t): (pose, float(s)) for t, pose, s in zip(path.t_ns, path.poses, turn_sigma, strict=True)}
        context = building_context(self._log.name, self._log.camera, path, images=self._log.has_images)
        if self._rrd is not None:
            self._sinks.append(MapFile(self._rrd, context))
        if self._kind != "none":
            self.viewer = MapView(self._kind, context)
            self._sinks.append(self.viewer)
            if self.viewer.address:
                typer.echo(f"Watch at {self.viewer.address}", err=True)
        for sink in self._sinks:
            self._open.callback(sink.close)

    def frame(self, t_ns: int, edges: Edges) -> None:
        """Take the edges of one image; those off the path are left out."""
        if not self._sinks or t_ns not in self._step_at:
            return
        (pose, turn_sigma), image = self._step_at[t_ns], self._frames[t_ns]
        seen = self._live.step(pose, edges, turn_sigma)
        encoded = image.encoded() if isinstance(image, ImageEvent) else None
        shown = np.flatnonzero(np.isin(self._live.numbers, seen.feature))
        points, cov = self._live.points, self._live.cov
        growing = Growing(t_ns, pose, encoded, edges, seen.feature, seen.is_landmark, points, cov, shown)
        for sink in self._sinks:
            sink.frame(growing)

    def finish(self, built: MapBuilt) -> None:
        """Show the map that came out, and where loops were closed the path before and after."""
        made = built.landmark_map
        before = Trajectory(built.trajectory.t_ns, built.slam.before) if built.slam else None
        sigma_cm = 100 * np.sqrt(np.trace(made.cov, axis1=1, axis2=2) / 2)
        text = f"{len(made)} landmarks refined in one problem, good to {np.median(sigma_cm):.2f} cm (median)"
        for sink in self._sinks:
            sink.finish(Finished(made, built.trajectory, before, text))
