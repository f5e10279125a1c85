"""What a live run needs of a network: one protocol for every transport, and how to open the one that is asked for."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from typing import Protocol

from localiser.config import MOST_DOMAIN, LiveParameters
from localiser.errors import InputError
from localiser.ros import Service, Topic

Take = Callable[[bytes, bytes], None]
"""Takes a message (CDR) and the identity of who sent it (empty where the transport does not tell), in any thread."""

Reply = Callable[[bytes], None]
"""Answers one request of a service; from any thread, once."""


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

    def serve(self, service: Service, take: Callable[[bytes, Reply], None]) -> None:
        """Hand every request (CDR) of a service over, with what answers it."""

    def listen_to_all(self, take: Callable[[str, str | None, bytes], None]) -> None:
        """Hand over topic, type where the network tells it, and content of every message, also of unknown topics."""

    def is_joined(self) -> bool:
        """Whether the network is there, as a router of zenoh must be; True where that cannot be known."""

    def report_to(self, report: Callable[[str], None]) -> None:
        """Tell of what keeps messages from passing from now on, in any thread, where the network tells it."""

    def close(self) -> None:
        """Leave the network."""


ENDPOINT = "tcp/127.0.0.1:7447"
"""Where a router on this machine is expected; 7447 is zenoh's port."""

_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)*")


def prefix_of(live: LiveParameters) -> str:
    """Return the namespace as it stands before topics: "" or such as `/robot1`. Raises InputError."""
    prefix = "/" + live.namespace.strip("/") if live.namespace.strip("/") else ""
    if not _NAMESPACE.fullmatch(prefix):
        expected = "expected letters, digits and underscores, such as robot1"
        raise InputError(f"{expected}, found {live.namespace!r}", field="live.namespace")
    return prefix


def open_transport(live: LiveParameters, node: str = "localiser", *, wait: bool = True) -> Transport:
    """Join the network under the name of a node. wait: whether to wait for a router, in the background.

    ROS's own ROS_DISTRO counts: Humble has no hashes in the keys of zenoh, and longer identities over DDS. Raises
    InputError.
    """
    prefix, humble = prefix_of(live), os.environ.get("ROS_DISTRO", "") == "humble"
    if live.dds >= 0:
        from localiser.live.dds_transport import DdsTransport

        return DdsTransport(live.dds, live.interface, node, prefix, humble=humble)
    from localiser.live.zenoh_transport import RmwNames, ZenohLink, ZenohTransport

    link = ZenohLink(endpoints_of(live), live.listen, config_file=live.zenoh_config, wait=wait)
    return ZenohTransport(link, RmwNames(_domain(live), prefix, node, not humble))


def endpoints_of(live: LiveParameters) -> tuple[str, ...]:
    """Return the routers to connect to: where nothing says where the network is, one on this machine."""
    return live.connect or (() if live.listen or live.zenoh_config else (ENDPOINT,))


def network_of(live: LiveParameters) -> str:
    """Return in words where a run is reached."""
    if live.dds >= 0:
        return f"domain {live.dds} of DDS on the interface {live.interface}"
    where = ", ".join([*endpoints_of(live), *live.listen]) or live.zenoh_config
    return f"{where}, domain {_domain(live)}"


def _domain(live: LiveParameters) -> int:
    if live.domain >= 0:
        return live.domain
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not (text.isascii() and text.isdigit() and int(text) <= MOST_DOMAIN):
        raise InputError(f"expected a domain from 0 to {MOST_DOMAIN}, found {text!r}", field="ROS_DOMAIN_ID")
    return int(text)


def checked_name(given: str, field: str = "live.topics") -> str:
    """Return the name of a topic or service without its first slash. Raises InputError unless ROS 2 takes it."""
    name = given.strip("/")
    if not name or not all(part.replace("_", "a").isalnum() and part.isascii() for part in name.split("/")):
        raise InputError(f"expected the name of a topic, found {given!r}", field=field)
    return name


def dds_type(msgtype: str) -> str:
    """Return the name of a type of messages or services in DDS, and in keys of zenoh: `nav_msgs::msg::dds_::Path_`."""
    package, kind, name = msgtype.split("/")
    return f"{package}::{kind}::dds_::{name}_"
