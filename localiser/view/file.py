"""A run as a Rerun recording on disk."""

from __future__ import annotations

from pathlib import Path

from localiser.filter import LocatedFrame
from localiser.view.context import Context


class RrdFile:
    """Writes every frame to a `.rrd` file, on a stream of its own: no viewer can hold it up.

    Raises OutputError where the file cannot be written.
    """

    def __init__(self, path: Path, context: Context) -> None:
        # Rerun takes most of a second to import: only who records pays for it.
        from localiser.view.recorder import Recorder, stream_to_file

        self._stream = stream_to_file(path, context)
        self._recorder = Recorder(self._stream, context)
        self._frames = 0

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
