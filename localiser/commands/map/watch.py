"""Watch a map being built: a map that grows image by image as edges are found, then the map that came out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from localiser import view
from localiser.edges import Edges
from localiser.geometry import Array, Trajectory
from localiser.mapping import LiveMap, MappingParameters
from localiser.storage import ImageEvent, Log
from localiser.view import Finished, Growing, MapFile, MapView, building_context

if TYPE_CHECKING:
    from localiser.commands.map.build import MapBuilt


class MapSink(Protocol):
    """What takes the building of a map, image by image: a file, a viewer."""

    def frame(self, frame: Growing) -> None:
        """Take one image and what is known after it."""

    def finish(self, finished: Finished) -> None:
        """Take what came out."""

    def close(self) -> None:
        """End, whether anything came out or not."""


class MapWatch:
    """Grows a live map along a path, and hands every step of it to sinks; without sinks it does nothing.

    rrd: a recording to write. kind: of a viewer, see `view.LiveView`, or none. say: gets the address to watch it at.
    Raises OutputError, InputError.
    """

    def __init__(self, rrd: Path | None, kind: view.live.Kind, say: Callable[[str], None]) -> None:
        view.check_kind(kind)
        self._rrd, self._kind, self._say = rrd, kind, say
        self._sinks: list[MapSink] = []
        self.viewer: MapView | None = None

    def begin(self, log: Log, path: Trajectory, turn_sigma: Array, parameters: MappingParameters) -> None:
        """Open the sinks. path: poses (T, 3) as known while driving. turn_sigma: (T,) rad, errors of their turns."""
        self._frames = {frame.t_ns: frame for frame in log.frames}
        self._path, self._turn_sigma = path, turn_sigma
        self._number_at = {int(t): number for number, t in enumerate(path.t_ns)}
        context = building_context(log.name, log.camera, path, images=log.has_images)
        if self._rrd is not None:
            self._sinks.append(MapFile(self._rrd, context))
        if self._kind != "none":
            self.viewer = MapView(self._kind, context)
            self._sinks.append(self.viewer)
            if self.viewer.address:
                self._say(self.viewer.address)
        self._live = LiveMap(log.camera, parameters) if self._sinks else None

    def frame(self, t_ns: int, edges: Edges) -> None:
        """Take the edges of one image; those off the path are left out."""
        number = self._number_at.get(t_ns)
        if number is None or self._live is None:
            return
        pose, image = self._path.poses[number], self._frames[t_ns]
        seen = self._live.step(pose, edges, float(self._turn_sigma[number]))
        encoded = image.encoded() if isinstance(image, ImageEvent) else None
        points, cov, numbers = self._live.points, self._live.cov, self._live.numbers
        shown = np.flatnonzero(np.isin(numbers, seen.feature))
        growing = Growing(t_ns, pose, encoded, edges, seen.feature, seen.is_landmark, points, cov, shown)
        for sink in self._sinks:
            sink.frame(growing)

    def finish(self, built: MapBuilt) -> None:
        """Show the map that came out, and where loops were closed the path before and after."""
        slam, made = built.slam, built.landmark_map
        before = None if slam is None else Trajectory(built.trajectory.t_ns, slam.before)
        sigma_cm = 100 * np.sqrt(np.trace(made.cov, axis1=1, axis2=2) / 2)
        text = f"{len(made)} landmarks refined in one problem, good to {np.median(sigma_cm):.2f} cm (median)"
        for sink in self._sinks:
            sink.finish(Finished(made, built.trajectory, before, text))

    def close(self) -> None:
        """End all sinks."""
        for sink in self._sinks:
            sink.close()


@contextmanager
def watching(rrd: Path | None, kind: view.live.Kind, say: Callable[[str], None]) -> Iterator[MapWatch]:
    """Yield what watches a build, and end it in any case; see `MapWatch`."""
    watch = MapWatch(rrd, kind, say)
    try:
        yield watch
    finally:
        watch.close()
