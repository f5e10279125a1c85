"""The edges of the next images, found by another thread while the filter works on the last one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

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
    try:
        yield from _ahead(events, measure, is_image, pool)
    finally:
        pool.shutdown(cancel_futures=True)


def _ahead(
    events: Iterable[Any], measure: Callable[[Any], T], is_image: Callable[[Any], bool], pool: ThreadPoolExecutor
) -> Iterator[tuple[Any, Found[T] | None]]:
    waiting: deque[tuple[Any, Found[T] | None]] = deque()
    images, source, failure = 0, iter(events), None
    while True:
        try:
            event = next(source)
        except StopIteration:
            break
        except Exception as error:
            failure = error
            break
        found: Found[T] | None = pool.submit(measure, event).result if is_image(event) else None
        waiting.append((event, found))
        images += found is not None
        while images > IMAGES_AHEAD:
            event, found = waiting.popleft()
            images -= found is not None
            yield event, found
    yield from waiting
    if failure is not None:
        raise failure
