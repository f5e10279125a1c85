"""What a live run needs of a network: one protocol for every transport, and optional abilities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from localiser.ros import Service

Take = Callable[[bytes, bytes], None]
"""Takes a message (CDR) and the identity of who sent it (empty where the transport does not tell), in any thread."""

Reply = Callable[[bytes], None]
"""Answers one request of a service; from any thread, once."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic with its quality of service, as ROS 2 has it. name: begins with a slash. msgtype: `pkg/msg/Name`.

    latched: transient local, the last messages are kept for those who subscribe later. reliable: else best effort.
    depth: how many messages are kept.
    """

    name: str
    msgtype: str
    latched: bool = False
    reliable: bool = True
    depth: int = 10


class Transport(Protocol):
    """Carries messages of ROS 2, which are CDR, under the names of topics. Nothing here waits for a peer."""

    def subscribe(self, topic: Topic, take: Take) -> None:
        """Hand every message on a topic over; of a latched topic also those that were sent before."""

    def advertise(self, topic: Topic) -> None:
        """Show others that messages will come on a topic."""

    def publish(self, topic: Topic, content: bytes) -> None:
        """Send a message; to those who are too slow for it, not at all. Never waits."""

    def is_heard(self, topic: Topic) -> bool:
        """Whether a message on this topic would reach anybody now; True where that cannot be known."""

    def close(self) -> None:
        """Leave the network."""


@runtime_checkable
class ServesRequests(Protocol):
    """A transport that can also answer requests of services."""

    def serve(self, service: Service, take: Callable[[bytes, Reply], None]) -> None:
        """Hand every request (CDR) over, with what answers it."""


@runtime_checkable
class ReportsProblems(Protocol):
    """A transport that notices what keeps messages from passing."""

    def report_to(self, report: Callable[[str], None]) -> None:
        """Tell of what is wrong from now on, in any thread."""


@runtime_checkable
class HearsAll(Protocol):
    """A transport that can also listen to topics that are not known before."""

    def listen_to_all(self, take: Callable[[str, str | None, bytes], None]) -> None:
        """Hand over topic, type where the network tells it, and content of every message."""
