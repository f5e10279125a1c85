"""Open the transport that a user asks for."""

from __future__ import annotations

import os
import re

from localiser.config import MOST_DOMAIN, LiveParameters
from localiser.errors import InputError
from localiser.live.transports.dds_transport import DdsTransport
from localiser.live.transports.link import ENDPOINT, ZenohLink
from localiser.live.transports.rmw_names import RmwNames
from localiser.live.transports.transport import Transport
from localiser.live.transports.zenoh_transport import ZenohTransport

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
        return DdsTransport(live.dds, live.interface, node, prefix, humble=humble)
    link = ZenohLink(endpoints_of(live), live.listen, config_file=live.zenoh_config, wait=wait)
    return ZenohTransport(link, RmwNames(_domain(live), prefix, node, not humble))


def endpoints_of(live: LiveParameters) -> tuple[str, ...]:
    """Return the routers to connect to: where nothing says where the network is, one on this machine."""
    return live.connect or (() if live.listen or live.zenoh_config else (ENDPOINT,))


def _domain(live: LiveParameters) -> int:
    if live.domain >= 0:
        return live.domain
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not (text.isascii() and text.isdigit() and int(text) <= MOST_DOMAIN):
        raise InputError(f"expected a domain from 0 to {MOST_DOMAIN}, found {text!r}", field="ROS_DOMAIN_ID")
    return int(text)
