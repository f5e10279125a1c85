"""Images of a replay: their edges are found ahead of the filter, and what was located is kept in a temporary file."""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from tempfile import SpooledTemporaryFile
from typing import Any, TypeVar

import numpy as np

from localiser import particles
from localiser.documents import decode, encode
from localiser.errors import OutputError
from localiser.filter import Located, LocatedFrame
from localiser.geometry import Array

IN_MEMORY = 4_000_000  # bytes, beyond which the file is written to the disk: about 400 images


@dataclass(frozen=True, slots=True)
class _Kept:
    """What the file has of a located image: all but the image itself."""

    located: Located
    truth: Array | None
    stage_ms: dict[str, float]
    wide_cov: Array | None
    map_name: str


class KeptFrames(Sequence[LocatedFrame]):
    """Located images in order, without the images. Each is read again when it is asked for, as a new object.

    The file has no name, and goes with this object. Raises OutputError where it cannot be written.
    """

    def __init__(self) -> None:
        self._file = SpooledTemporaryFile(max_size=IN_MEMORY)  # noqa: SIM115  (open as long as this object is there)
        self._ends = array("q")
        self._last: LocatedFrame | None = None

    def append(self, frame: LocatedFrame) -> None:
        """Keep one more, without what grows with pixels or particles."""
        located, none = frame.located, np.zeros(0, dtype=np.int64)
        clusters = located.clusters and replace(located.clusters, label=none)
        few = particles.take(located.particles, none)
        frame = replace(frame, located=replace(located, particles=few, clusters=clusters, sighting=None), image=None)
        kept = _Kept(frame.located, frame.truth, dict(frame.stage_ms), frame.wide_cov, frame.map_name)
        try:
            self._file.seek(self._begin(len(self)))
            self._file.write(encode(kept))
        except OSError as error:
            raise OutputError(f"the temporary file of located images cannot be written: {error}") from error
        self._ends.append(self._file.tell())
        self._last = frame

    def __len__(self) -> int:
        return len(self._ends)

    def __getitem__(self, index: Any) -> Any:
        chosen = range(len(self))[index]
        return self._at(chosen) if isinstance(chosen, int) else [self._at(each) for each in chosen]

    def _at(self, index: int) -> LocatedFrame:
        if index == len(self) - 1 and self._last is not None:
            return self._last
        self._file.seek(self._begin(index))
        kept: _Kept = decode(_Kept, self._file.read(self._ends[index] - self._begin(index)))
        return LocatedFrame(kept.located, None, kept.truth, kept.stage_ms, kept.wide_cov, kept.map_name)

    def _begin(self, index: int) -> int:
        return self._ends[index - 1] if index else 0


T = TypeVar("T")
Found = Callable[[], T]

IMAGES_AHEAD = 2  # more would only wait in memory


def in_order(
    events: Iterable[Any], measure: Callable[[Any], T], is_image: Callable[[Any], bool], threads: int
) -> Iterator[tuple[Any, Found[T] | None]]:
    """Yield each event, and for an image what returns or raises what `measure` does of it; None for other events.

    threads: 1 to measure when that is asked for, more to measure ahead. Order, results and errors are the same: an
    error in reading events is raised when all events before it have been yielded.
    """
    if threads < 2:
        for event in events:
            yield event, partial(measure, event) if is_image(event) else None
        return
    pool = ThreadPoolExecutor(1, thread_name_prefix="edges")
    waiting: deque[tuple[Any, Found[T] | None]] = deque()
    images, failure = 0, None
    try:
        try:
            for event in events:
                found: Found[T] | None = pool.submit(measure, event).result if is_image(event) else None
                waiting.append((event, found))
                images += found is not None
                while images > IMAGES_AHEAD:
                    images -= waiting[0][1] is not None
                    yield waiting.popleft()
        except Exception as error:  # in reading
            failure = error
        yield from waiting
        if failure is not None:
            raise failure
    finally:
        pool.shutdown(cancel_futures=True)
