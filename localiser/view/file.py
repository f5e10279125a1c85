"""Record a run to a Rerun file."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from localiser.filter import LocatedFrame
from localiser.view.context import Context

if TYPE_CHECKING:
    from localiser.view.recorder import Recorder
    from localiser.view.recording_file import RecordingFile


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
        from localiser.view.recording_file import RecordingFile

        stream = new_stream(self._context)
        file = RecordingFile(self._path, stream, blueprint(self._context))
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
