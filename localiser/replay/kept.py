"""What a replay keeps of its images until the end: in a temporary file, so that memory does not grow with a log."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from tempfile import SpooledTemporaryFile
from typing import overload

from localiser.errors import OutputError
from localiser.filter import Located, LocatedFrame
from localiser.geometry import Array
from localiser.observation import Matches
from localiser.storage import decode, encode

IN_MEMORY = 4_000_000  # bytes, beyond which the file is written to the disk: about 400 images


@dataclass(frozen=True, slots=True)
class _Kept:
    """What the file has of a located image: all but the image itself."""

    located: Located
    matches: Matches
    truth: Array | None
    stage_ms: dict[str, float]


class KeptFrames(Sequence[LocatedFrame]):
    """Located images in order, without the images. Each is read again when it is asked for, as a new object.

    The file has no name, and goes with this object. Raises OutputError where it cannot be written.
    """

    def __init__(self) -> None:
        self._file = SpooledTemporaryFile(max_size=IN_MEMORY)  # noqa: SIM115  (open as long as this object is there)
        self._ends = array("q")
        self._last: LocatedFrame | None = None

    def append(self, frame: LocatedFrame) -> None:
        """Keep one more."""
        kept = _Kept(frame.located, frame.matches, frame.truth, dict(frame.stage_ms))
        try:
            self._file.seek(self._begin(len(self)))
            self._file.write(encode(kept))
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
        kept: _Kept = decode(_Kept, self._file.read(self._ends[index] - self._begin(index)))
        return LocatedFrame(kept.located, kept.matches, None, kept.truth, kept.stage_ms)

    def _begin(self, index: int) -> int:
        return self._ends[index - 1] if index else 0
