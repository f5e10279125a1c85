"""A bounded queue of messages. When the program is busy, the newest messages are kept."""

from __future__ import annotations

import heapq
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from threading import Condition

MOST_IMAGES = 32
MOST_OTHERS = 1024
"""Seconds of images, and of odometry: what a pause of the program may take, and no more than is read within 0.3 s."""

MOST_BYTES = 128 * 2**20
"""Of all that waits, whatever its sizes."""


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

    def __init__(
        self, most_images: int = MOST_IMAGES, most_others: int = MOST_OTHERS, most_bytes: int = MOST_BYTES
    ) -> None:
        """Start empty."""
        self._most, self._most_others, self._most_bytes = {"image": most_images}, most_others, most_bytes
        self._queues: dict[str, deque[tuple[int, Arrival]]] = {}
        self._bytes: Counter[str] = Counter()
        self._order = count()
        self._changed = Condition()
        self.dropped: Counter[str] = Counter()

    def put(self, arrival: Arrival) -> None:
        """Take a message in; never waits."""
        role = arrival.role
        with self._changed:
            queue = self._queues.setdefault(role, deque())
            if len(queue) >= self._most.get(role, self._most_others):
                self._drop(role)
            queue.append((next(self._order), arrival))
            self._bytes[role] += len(arrival.content)
            while self._bytes.total() > self._most_bytes:  # of what needs the most memory
                self._drop(max(self._bytes, key=self._bytes.__getitem__))
            self._changed.notify()

    def take(self, wait_s: float) -> list[Arrival]:
        """Return all that has arrived, in that order; waits for something to arrive, but not longer than `wait_s`."""
        with self._changed:
            self._changed.wait_for(lambda: any(self._queues.values()), wait_s)
            queues, self._queues = self._queues, {}
            self._bytes.clear()
        return [arrival for _, arrival in heapq.merge(*queues.values())]

    def _drop(self, role: str) -> None:
        _, oldest = self._queues[role].popleft()
        self._bytes[role] -= len(oldest.content)
        self.dropped[role] += 1
