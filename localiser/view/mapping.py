"""A map as it is built: image and tracks, landmarks with their ellipses, the path before and after loops closed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.documents import draft_beside, output_errors, remove
from localiser.edges import Edges
from localiser.filter import Image
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.view import paths
from localiser.view.paths import Context

LANDMARKS, SIGMA, TRACKS = "plots/landmarks", "plots/sigma", "plots/tracks"
_TITLES = {LANDMARKS: "Landmarks", SIGMA: "Their 1σ, cm", paths.COUNTS: "Edges", TRACKS: "Tracks"}
_MARGIN_M = 1.5  # around the path: walls stand beside it


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
    """Writes how a map came about to a `.rrd` file, if a map comes out. Raises OutputError where it cannot be written.

    Until then the recording has a name of its own: a build that is refused leaves what was there before.
    """

    def __init__(self, path: Path, context: Context) -> None:
        from localiser.view.file import RecordingFile
        from localiser.view.recorder import MapRecorder, new_stream

        self._path, self._draft = path, draft_beside(path)
        stream = new_stream(context)
        self._file = RecordingFile(self._draft, stream, _layout(context), becomes=path)
        self._recorder = MapRecorder(stream, context)
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


def building_context(name: str, camera: Camera, path: Trajectory, *, images: bool) -> Context:
    """Return what a view of a map must know that is yet to be built: the path (T, 3) that it is built along."""
    nothing = LandmarkMap.from_points(np.zeros((0, 2)))
    return Context(name, camera, nothing, truth=path, images=images, application="localiser map build")


def _layout(context: Context) -> Any:
    from localiser.view.layout import blueprint

    return blueprint(context, _TITLES, margin_m=_MARGIN_M)
