"""Record a run to a Rerun file; a file that cannot be written is an error.

Rerun's own writer of files prints an error when the disk is full, drops the rest, and then waits for ever when the file
is to be ended. So it writes into a pipe, and a thread of our own writes the file.
"""

from __future__ import annotations

import atexit
import os
from functools import cached_property
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

from localiser.documents import output_errors, write_all
from localiser.filter import LocatedFrame
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
