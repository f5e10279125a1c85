"""Stop a run by Ctrl-C, SIGTERM or SIGHUP between two images, so that all outputs end with the same image."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = [signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]


class Stop(threading.Event):
    """Is set once the user, or the system, asks a run to stop. exit_code: how the program then ends, as shells do."""

    exit_code = 128 + signal.SIGINT


@contextmanager
def asked_to_stop() -> Iterator[Stop]:
    """Hold Ctrl-C, SIGTERM and SIGHUP back; yields an event that they set. A second one is not held back.

    A signal that is ignored, as SIGHUP under `nohup`, stays so. In other threads than the main one, which get no
    signals, nothing is changed.
    """
    asked = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def ask(number: int, _frame: FrameType | None) -> None:
        asked.exit_code = 128 + number
        asked.set()
        restore()

    held = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, ask) for number in held}
    try:
        yield asked
    finally:
        restore()
