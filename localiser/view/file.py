"""Record a run, or how a map came about, to a Rerun file; a file that cannot be written is an error.

Rerun's own writer of files prints an error when the disk is full, drops the rest, and then waits for ever when the file
is to be ended. So it writes into a pipe, and a thread of our own writes the file.
"""

from __future__ import annotations

import atexit
import os
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.documents import output_errors, write_all
from localiser.edges import Edges
from localiser.filter import Image, LocatedFrame
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.view import paths
from localiser.view.paths import Context

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from localiser.view.recorder import Recorder


_AT_ONCE = 1 << 16


class RrdFile:
    """Writes every frame to a `.rrd` file, on a stream of its own: no viewer can hold it up.

    The file is made with the first frame, or at the end: Rerun takes most of a second to import. Raises OutputError
    then where it cannot be written.
    """

    def __init__(self, path: Path, context: Context) -> None:
        self._path, self._context = path, context
        self._frames = 0

    @cached_property
    def _open(self) -> tuple[Recorder, RecordingFile]:
        from localiser.view.layout import blueprint
        from localiser.view.recorder import Recorder, new_stream

        stream = new_stream(self._context)
        file = RecordingFile(self._path, stream, blueprint(self._context.of_first_map))
        return Recorder(stream, self._context), file

    def frame(self, frame: LocatedFrame) -> None:
        """Write what the filter knows after one image."""
        self._open[0].frame(self._frames, frame)
        self._frames += 1

    def message(self, t_ns: int, text: str, level: str = "INFO") -> None:
        """Write a line to the text log."""
        self._open[0].message(t_ns, text, level)

    def close(self, complete: bool) -> None:
        """End the file, which can be opened from now on; an incomplete run is said to be one in its text log.

        Raises OutputError where it broke off.
        """
        recorder, file = self._open
        recorder.end(complete)
        file.end()


class RecordingFile:
    """Writes what is logged to a stream into a new file. Where that fails, the rest is dropped, and `end` tells it."""

    def __init__(self, path: Path, stream: rr.RecordingStream, layout: rrb.Blueprint) -> None:
        """Open the file, with the layout in which it is shown. Raises OutputError."""
        self._path, self._stream = path, stream
        self._failure: OSError | None = None
        with output_errors(self._path):
            self._file = path.open("wb", buffering=0)
            self._source, target = os.pipe()
        self._thread = Thread(target=self._work, name="recording file", daemon=True)
        self._thread.start()
        stream.save(f"/dev/fd/{target}", default_blueprint=layout)
        os.close(target)
        atexit.register(self._finish)  # before Rerun's own, which would wait for a thread that has ended

    def end(self) -> None:
        """End the file, which can be opened from now on. Raises OutputError where it broke off."""
        atexit.unregister(self._finish)
        self._finish()
        with output_errors(self._path):
            if self._failure is not None:
                raise self._failure

    def _finish(self) -> None:
        self._stream.flush()
        self._stream.disconnect()
        self._thread.join()

    def _work(self) -> None:
        with self._file as file:
            while content := os.read(self._source, _AT_ONCE):
                try:
                    if self._failure is None:
                        write_all(file.write, content)
                except OSError as error:
                    self._failure = error
        os.close(self._source)


# -- how a map came about ---------------------------------------------------------------------------------------------

LANDMARKS, SIGMA = "plots/landmarks", "plots/sigma"
_TITLES = {LANDMARKS: "Landmarks", SIGMA: "Their 1σ, cm", paths.COUNTS: "Edges"}
_MARGIN_M = 1.5  # around the path: walls stand beside it


@dataclass(frozen=True, slots=True, eq=False)
class Growing:
    """One image and what is known after it.

    pose: (3,) of the robot. is_landmark: (E,) whether each edge is of a landmark. points, cov: (L, 2), (L, 2, 2) of the
    landmarks. shown: (M,) those that this image shows.
    """

    t_ns: int
    pose: Array
    image: Image | None
    edges: Edges
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


def record_map(
    path: Path, name: str, camera: Camera, frames: Iterable[Growing], finished: Finished, *, images: bool
) -> None:
    """Write how a map came about to a new `.rrd` file. images: whether frames have any. Raises OutputError."""
    from localiser.view.layout import blueprint
    from localiser.view.recorder import MapRecorder, new_stream

    nothing = LandmarkMap.from_points(np.zeros((0, 2)))
    context = Context(name, camera, nothing, finished.path, images, application="localiser map build")
    stream = new_stream(context)
    file = RecordingFile(path, stream, blueprint(context, _TITLES, margin_m=_MARGIN_M))
    try:
        recorder = MapRecorder(stream, context)
        for frame in frames:
            recorder.frame(frame)
        recorder.finish(finished)
    finally:
        file.end()
