"""A camera or a stream, read by OpenCV: a device's number, a file, an RTSP or HTTP address."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.documents import text_of
from localiser.errors import InputError

_RETRY_S = 1.0
Take = Callable[[int, NDArray[np.uint8]], None]


class CameraSource:
    """Hands every frame with its time over, in a thread of its own; a camera that goes away is tried again.

    A frame's time is when it came out of the camera, by the calendar. A file is played at its own rate.
    """

    def __init__(self, address: str, take: Take) -> None:
        """Open the camera. take: gets the time (ns) and (H, W, 3) BGR or (H, W) grey. Raises InputError."""
        self._address, self._take = address, take
        self._is_file = Path(address).is_file()
        self._stop = Event()
        self._capture: Any = _open(address)
        if self._capture is None:
            raise InputError("expected a camera that can be opened", path=address, field="--image")
        self._thread = Thread(target=self._read, name="camera", daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def close(self) -> None:
        """Stop reading."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def _read(self) -> None:
        begin_ns = time.time_ns()
        while not self._stop.is_set():
            done, image = self._capture.read() if self._capture is not None else (False, None)
            if done and image is not None and image.dtype == np.uint8:
                t_ns = time.time_ns()
                if self._is_file:
                    t_ns = begin_ns + round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
                    self._stop.wait((t_ns - time.time_ns()) / 1e9)
                self._take(t_ns, image)
            elif self._is_file:
                return
            else:
                self._stop.wait(_RETRY_S)
                self._capture = _open(self._address)


def _open(address: str) -> Any | None:
    """Return the open camera, or None."""
    capture = (
        cv2.VideoCapture(int(address))
        if address.isascii() and address.isdigit()
        else cv2.VideoCapture(text_of(address))
    )
    if not capture.isOpened():
        return None
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # where the driver knows it: the newest frame, not the oldest
    return capture
