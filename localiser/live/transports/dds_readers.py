"""Takes what subscribers of DDS have received, in one thread.

The threads of Cyclone DDS that read the network do not wait for it. In a flood it is therefore the subscriber that
drops the oldest messages, by its depth, and no buffer of a socket keeps thousands of them until they are of no use.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from threading import Thread
from typing import Any

from localiser.live.transports.dds_types import dds
from localiser.live.transports.transport import Take

_MOST_AT_ONCE = 64
_LONGEST_NS = 10**9


class Readers:
    """The subscribers of a participant. Their messages are handed over in the order in which each received them."""

    def __init__(self, participant: Any, report: Callable[[str], None]) -> None:
        """Begin with none. report: takes what went wrong."""
        core = dds().core
        self._report, self._stopped = report, False
        self._taken: list[tuple[Any, Any, Take]] = []
        self._wait, self._stop = core.WaitSet(participant), core.GuardCondition(participant)
        self._wait.attach(self._stop)
        self._thread = Thread(target=self._run, name="dds", daemon=True)
        self._thread.start()

    def add(self, reader: Any, take: Take) -> None:
        """Hand over all that a reader has, and will receive."""
        core = dds().core
        anything = core.SampleState.Any | core.ViewState.Any | core.InstanceState.Any
        condition = core.ReadCondition(reader, anything)
        self._taken.append((condition, reader, take))
        self._wait.attach(condition)

    def close(self) -> None:
        """Stop; nothing is handed over any more."""
        self._stopped = True
        self._stop.set(True)
        self._thread.join()
        for condition, _, _ in self._taken:
            self._wait.detach(condition)
            condition._delete(condition._ref)
        self._wait.detach(self._stop)
        for entity in (self._stop, self._wait):
            entity._delete(entity._ref)

    def _run(self) -> None:
        while not self._stopped:
            self._wait.wait(_LONGEST_NS)
            for condition, reader, take in tuple(self._taken):
                if not self._stopped and condition.triggered:
                    self._hand_over(reader, take)

    def _hand_over(self, reader: Any, take: Take) -> None:
        """Take what a reader has, and no more at once than leaves time for the others."""
        try:
            samples = reader.take(_MOST_AT_ONCE)
        except dds().core.DDSException as error:
            self._report(f"{reader.topic.name}: messages could not be read: {error}")
            return
        for sample in samples:
            if content := getattr(sample, "content", b""):  # none: news of a publisher that goes
                take(content, struct.pack("<Q", sample.sample_info.publication_handle))
