"""A bounded queue of messages. When the program is busy, the newest messages are kept."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Condition

MOST_IMAGES = 32
MOST_OTHERS = 8192
"""Seconds of images, and minutes of odometry: what a pause of the program may take."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A message as it came. role: what its topic is for. content: its bytes, CDR as ROS 2 has it.

    at_ns: when it came, by this machine's monotonic clock. wall_ns: the same by the calendar. source: who sent it, b""
    where the network does not tell. reply: answers it, where it is a request of a service.
    """

    role: str
    topic: str
    content: bytes
    at_ns: int = field(default_factory=time.monotonic_ns)
    wall_ns: int = field(default_factory=time.time_ns)
    source: bytes = b""
    reply: Callable[[bytes], None] | None = None


class Inbox:
    """A queue from the threads of the sources to the loop; where it is full, the oldest of a role is dropped."""

    def __init__(self, most_images: int = MOST_IMAGES, most_others: int = MOST_OTHERS) -> None:
        """Start empty."""
        self._most = {"image": most_images}
        self._most_others = most_others
        self._queue: deque[Arrival] = deque()
        self._held: Counter[str] = Counter()
        self._changed = Condition()
        self.dropped: Counter[str] = Counter()

    def put(self, arrival: Arrival) -> None:
        """Take a message in; never waits."""
        role = arrival.role
        with self._changed:
            if self._held[role] >= self._most.get(role, self._most_others):
                oldest = next(index for index, held in enumerate(self._queue) if held.role == role)
                del self._queue[oldest]
                self.dropped[role] += 1
            else:
                self._held[role] += 1
            self._queue.append(arrival)
            self._changed.notify()

    def take(self, wait_s: float) -> list[Arrival]:
        """Return all that has arrived, in that order; waits for something to arrive, but not longer than `wait_s`."""
        with self._changed:
            self._changed.wait_for(lambda: self._queue, wait_s)
            taken = list(self._queue)
            self._queue.clear()
            self._held.clear()
            return taken
