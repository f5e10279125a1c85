"""Open the transport that a user asks for."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from localiser.errors import InputError
from localiser.live.transports.dds_transport import LOOPBACK, DdsTransport
from localiser.live.transports.link import ENDPOINT, ZenohLink
from localiser.live.transports.rmw_names import RmwNames
from localiser.live.transports.transport import Transport
from localiser.live.transports.zenoh_transport import ZenohTransport

MOST_DOMAIN = 232  # that ROS 2 allows
_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)*")


@dataclass(frozen=True, slots=True)
class NetworkOptions:
    """How to take part in a robot's network.

    connect: endpoints of routers; the first that can be reached is used. listen: where others may connect.
    config_file: a configuration of zenoh, as for TLS and passwords. domain: None for the environment's ROS_DOMAIN_ID,
    or 0. namespace: put before every topic that is not named by the user. distro: of ROS 2; None for the environment's
    ROS_DISTRO. Only Humble differs: no hashes in keys, longer identities over DDS.
    dds: a domain of DDS, which then takes the place of zenoh. interface: of the network, for DDS.
    """

    connect: Sequence[str] = (ENDPOINT,)
    listen: Sequence[str] = ()
    config_file: Path | None = None
    domain: int | None = None
    namespace: str = ""
    distro: str | None = None
    dds: int | None = None
    interface: str = LOOPBACK

    @property
    def prefix(self) -> str:
        """The namespace as it stands before topics: "" or such as `/robot1`. Raises InputError."""
        prefix = "/" + self.namespace.strip("/") if self.namespace.strip("/") else ""
        if not _NAMESPACE.fullmatch(prefix):
            raise InputError(
                f"expected letters, digits and underscores, such as robot1, found {self.namespace!r}",
                field="--namespace",
            )
        return prefix


def open_transport(options: NetworkOptions, node: str = "localiser", *, wait: bool = True) -> Transport:
    """Join the network under the name of a node. wait: whether to wait for a router, in the background.

    Raises InputError.
    """
    humble = (options.distro or os.environ.get("ROS_DISTRO", "")) == "humble"
    if options.dds is not None:
        domain = _checked_domain(str(options.dds), "--dds")
        return DdsTransport(domain, options.interface, node, options.prefix, humble=humble)
    link = ZenohLink(options.connect, options.listen, config_file=options.config_file, wait=wait)
    return ZenohTransport(link, RmwNames(_domain(options.domain), options.prefix, node, not humble))


def _domain(given: int | None) -> int:
    if given is not None:
        return _checked_domain(str(given), "--domain")
    return _checked_domain(os.environ.get("ROS_DOMAIN_ID", "") or "0", "ROS_DOMAIN_ID")


def _checked_domain(text: str, field: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text) <= MOST_DOMAIN):
        raise InputError(f"expected a domain from 0 to {MOST_DOMAIN}, found {text!r}", field=field)
    return int(text)
