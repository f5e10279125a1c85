"""What a replay keeps of its images until the end: in a temporary file, so that memory does not grow with a log."""

from __future__ import annotations

import pickle
from array import array
from collections.abc import Sequence
from tempfile import SpooledTemporaryFile
from typing import overload

from localiser.errors import OutputError
from localiser.filter import LocatedFrame

IN_MEMORY = 4_000_000  # bytes, beyond which the file is written to the disk: about 400 images


class KeptFrames(Sequence[LocatedFrame]):
    """Located images in order. Each is read again when it is asked for, so it is a new object each time.

    The file has no name, and goes with this object. Raises OutputError where it cannot be written.
    """

    def __init__(self) -> None:
        self._file = SpooledTemporaryFile(max_size=IN_MEMORY)  # noqa: SIM115  (open as long as this object is there)
        self._ends = array("q")
        self._last: LocatedFrame | None = None

    def append(self, frame: LocatedFrame) -> None:
        """Keep one more."""
        try:
            self._file.seek(self._begin(len(self)))
            pickle.dump(frame, self._file, pickle.HIGHEST_PROTOCOL)
        except OSError as error:
            raise OutputError(f"the temporary file of located images cannot be written: {error}") from error
        self._ends.append(self._file.tell())
        self._last = frame

    def __len__(self) -> int:
        return len(self._ends)

    @overload
    def __getitem__(self, index: int) -> LocatedFrame: ...

    @overload
    def __getitem__(self, index: slice) -> list[LocatedFrame]: ...

    def __getitem__(self, index: int | slice) -> LocatedFrame | list[LocatedFrame]:
        chosen = range(len(self))[index]
        return self._at(chosen) if isinstance(chosen, int) else [self._at(each) for each in chosen]

    def _at(self, index: int) -> LocatedFrame:
        if index == len(self) - 1 and self._last is not None:
            return self._last
        self._file.seek(self._begin(index))
        frame: LocatedFrame = pickle.loads(self._file.read(self._ends[index] - self._begin(index)))
        return frame

    def _begin(self, index: int) -> int:
        return self._ends[index - 1] if index else 0
