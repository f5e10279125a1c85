"""Ctrl-C or SIGTERM stops a run between two frames, so that every output ends with the same one."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def stop_request() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C and SIGTERM back; yields what to call where stopping is right, which raises KeyboardInterrupt then.

    A second one is not held back. In other threads than the main one, which get no signals, nothing is changed.
    """
    asked = threading.Event()

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def ask(_signal: int, _frame: FrameType | None) -> None:
        asked.set()
        restore()

    def stop_if_asked() -> None:
        if asked.is_set():
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield stop_if_asked
        return
    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop_if_asked
    finally:
        restore()
