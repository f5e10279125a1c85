"""Results of a live run as lines of JSON, which do not wait for their reader."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from queue import Empty, Queue
from threading import Thread

import numpy as np

from localiser import geometry
from localiser.documents import write_all
from localiser.filter import Located
from localiser.geometry import Array

MOST_LINES = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """One image's result as it goes out. stamp_ns, now_ns: of the image and of the wheels' last pose, by the robot.

    now: (3,) pose in the map then. by_wheels: whether wheels were ever heard. latency_ms: from the image's stamp, by
    this machine's calendar. error_m: where the robot tells the truth beside.
    """

    located: Located
    stamp_ns: int
    now_ns: int
    now: Array
    by_wheels: bool
    latency_ms: float
    error_m: float | None = None

    def line(self) -> str:
        """Return the line of JSON."""
        located, estimate = self.located, self.located.estimate
        x, z, heading = estimate.pose.tolist()
        now_x, now_z, now_heading = self.now.tolist()
        data = {
            "stamp_ns": self.stamp_ns,
            "t_ns": located.t_ns,
            "x": x,
            "z": z,
            "heading": heading,
            "cov": estimate.pose_cov[np.triu_indices(3)].tolist(),
            "now": {"stamp_ns": self.now_ns, "x": now_x, "z": now_z, "heading": now_heading},
            "edges": len(located.edges),
            "p_correct": round(float(located.p_correct), 4),
            "latency_ms": round(self.latency_ms, 3),
        }
        return json.dumps(data | ({} if self.error_m is None else {"error_m": round(self.error_m, 6)}))


def pose_now(located: Located, odometry_now: Array) -> Array:
    """Return the pose (3,) in the map at the wheels' last pose: the estimate, moved on by what the wheels did since."""
    return geometry.compose(located.estimate.pose, geometry.between(located.odometry, odometry_now))


class JsonLines:
    """Writes lines to a file descriptor on a thread of its own; of a reader that is too slow the oldest are dropped."""

    def __init__(self, descriptor: int) -> None:
        """Begin."""
        self._descriptor = descriptor
        self._queue: Queue[str | None] = Queue(MOST_LINES)
        self._thread = Thread(target=self._work, name="json", daemon=True)
        self._thread.start()

    def put(self, line: str | None) -> None:
        """Write a line; None ends the thread."""
        with suppress(Empty):
            if self._queue.full():
                self._queue.get_nowait()
        self._queue.put(line)

    def close(self) -> None:
        """End; waits a moment for a slow reader."""
        self.put(None)
        self._thread.join(1.0)

    def _work(self) -> None:
        with suppress(OSError):  # nobody reads any more
            while (line := self._queue.get()) is not None:
                write_all(partial(os.write, self._descriptor), f"{line}\n".encode())
