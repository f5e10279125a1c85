"""Record a live run on its own thread. A slow or full disk ends the recording and never the run."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path
from threading import Condition, Thread

from localiser.errors import OutputError
from localiser.storage.bags import TEXT, BagRecorder, Messages

COMMIT_S = 0.5
MOST_BYTES = 256 * 2**20
"""What may wait for the disk."""

CLOSE_WAIT_S = 10.0

_Row = tuple[str, str, int, bytes]


class Recording:
    """A bag of what came in and what was decided; written in the order in which it is told."""

    def __init__(self, path: Path, failed: Callable[[str], None], latched: Collection[str] = ()) -> None:
        """Make the bag. failed: is told, in another thread, why the recording ended. latched: see `BagRecorder`.

        Raises InputError, OutputError.
        """
        self._recorder = BagRecorder(path, latched)
        self._failed, self._messages = failed, Messages()
        self._queue: deque[_Row] = deque()
        self._bytes = 0
        self._changed = Condition()
        self._is_open = True
        self._thread = Thread(target=self._work, name="recording", daemon=True)
        self._thread.start()

    def write(self, topic: str, msgtype: str, t_ns: int, content: bytes) -> None:
        """Record a message that came at `t_ns`, by the calendar; never waits."""
        with self._changed:
            if not self._is_open:
                return
            self._queue.append((topic, msgtype, t_ns, content))
            self._bytes += len(content)
            self._changed.notify()

    def tell(self, topic: str, text: str) -> None:
        """Record what no message says."""
        self.write(topic, TEXT, time.time_ns(), self._messages.encode(self._messages.text(text)))

    def close(self) -> None:
        """Write what waits, and end."""
        with self._changed:
            self._is_open = False
            self._changed.notify()
        self._thread.join(CLOSE_WAIT_S)

    def _work(self) -> None:
        try:
            while self._write_waiting():
                pass
            self._recorder.close()
        except OutputError as error:
            self._end(str(error))

    def _write_waiting(self) -> bool:
        """Write and commit what has come; return whether there will be more."""
        due = time.monotonic() + COMMIT_S
        going_on = True
        while going_on and (left_s := due - time.monotonic()) > 0:
            with self._changed:
                self._changed.wait_for(lambda: self._queue or not self._is_open, left_s)
                rows, going_on = list(self._queue), self._is_open
                too_much, self._bytes = self._bytes > MOST_BYTES, 0
                self._queue.clear()
            if too_much:
                raise OutputError("the disk is too slow for what comes in")
            for row in rows:
                self._recorder.write(*row)
        self._recorder.commit()
        return going_on

    def _end(self, why: str) -> None:
        with self._changed:
            self._is_open = False
            self._queue.clear()
        with suppress(OutputError):  # the disk is still full; what was committed stays
            self._recorder.close()
        self._failed(f"The recording ended, the run goes on: {why}")
