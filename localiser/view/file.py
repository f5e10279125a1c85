"""A run as a Rerun recording on disk."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from localiser.filter import LocatedFrame
from localiser.view.context import Context

if TYPE_CHECKING:
    import rerun as rr

    from localiser.view.recorder import Recorder


class RrdFile:
    """Writes every frame to a `.rrd` file, on a stream of its own: no viewer can hold it up.

    The file is made with the first frame, or at the end: Rerun takes most of a second to import. Raises OutputError
    then where it cannot be written.
    """

    def __init__(self, path: Path, context: Context) -> None:
        self._path, self._context = path, context
        self._frames = 0

    @cached_property
    def _stream(self) -> rr.RecordingStream:
        from localiser.view.recorder import stream_to_file

        return stream_to_file(self._path, self._context)

    @cached_property
    def _recorder(self) -> Recorder:
        from localiser.view.recorder import Recorder

        return Recorder(self._stream, self._context)

    def frame(self, frame: LocatedFrame) -> None:
        """Write what the filter knows after one image."""
        self._recorder.frame(self._frames, frame)
        self._frames += 1

    def message(self, t_ns: int, text: str, level: str = "INFO") -> None:
        """Write a line to the text log."""
        self._recorder.message(t_ns, text, level)

    def close(self, complete: bool) -> None:
        """End the file, which can be opened from now on; an incomplete run is said to be one in its text log."""
        self._recorder.end(complete)
        self._stream.flush()
        self._stream.disconnect()
