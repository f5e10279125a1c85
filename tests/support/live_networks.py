"""The networks that a live run can be on: a zenoh router in this process, or a domain of DDS of its own."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest
from live_processes import free_domain, free_endpoint

from localiser.config import LiveParameters

KINDS = ("zenoh", "dds")


@dataclass(frozen=True, slots=True)
class Network:
    """A network. arguments: by which a command joins it. options: the same within a test."""

    arguments: tuple[object, ...]
    options: LiveParameters


def router(endpoint: str) -> Any:
    """Return a router at this endpoint, as a session of zenoh."""
    zenoh = pytest.importorskip("zenoh")
    config = zenoh.Config()
    settings = {"mode": "router", "listen/endpoints": [endpoint], "scouting/multicast/enabled": False}
    for name, value in settings.items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)


@contextmanager
def domains(kind: str) -> Iterator[Callable[[], Network]]:
    """Yield what makes a domain of ROS 2: each over the same router, or each of DDS on this machine."""
    if kind == "dds":
        pytest.importorskip("cyclonedds")
        yield _dds
        return
    endpoint = free_endpoint()
    numbers = iter(range(100))
    with router(endpoint):
        yield lambda: _zenoh(endpoint, next(numbers))


def _dds() -> Network:
    domain = free_domain()
    return Network(("--set", f"live.dds={domain}"), LiveParameters(dds=domain))


def _zenoh(endpoint: str, domain: int) -> Network:
    arguments = ("--set", f"live.connect={endpoint}", "--set", f"live.domain={domain}")
    return Network(arguments, LiveParameters((endpoint,), domain=domain))
