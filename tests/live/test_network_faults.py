"""Faults of the network that a live run gets over: its router goes away, the robot is started again, a flood."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
from folders import ROOT
from live_networks import KINDS, Network, domains
from live_processes import LEAST_HZ, SETTINGS, START, Program, free_endpoint, program
from short_log import CORRIDOR

from localiser.config import LiveParameters
from localiser.live import open_transport
from localiser.live.stand_in import WHEELS
from localiser.live.transport import Topic
from localiser.storage.bags import ODOM, POSE, Messages

pytestmark = pytest.mark.slow  # in part, without processes: test_transports.py, test_flood.py, test_senders.py

ROUTER = ROOT / "tests" / "support" / "zenoh_router.py"
FLOOD = 40_000
COUNT = 5
FAR_NS = 2 * 10**18  # a stamp in 2033
LIVE = ("live", "--map", CORRIDOR / "map.yaml", "--start", START, "--json", *SETTINGS)
ROBOT = ("simulate", CORRIDOR, "--serve", "--quiet")


@pytest.fixture(params=KINDS)
def network(request: pytest.FixtureRequest) -> Iterator[Network]:
    with domains(request.param) as domain:
        yield domain()


def ended(run: Program) -> str:
    """Return what a run said until it was ended."""
    run.end()
    said = run.all_said()
    assert "Traceback" not in said
    return said


def test_a_router_that_is_killed_and_comes_back() -> None:
    """Images are located again at the rate at which they come, and the poses go out again to who listened before."""
    pytest.importorskip("zenoh")
    endpoint = free_endpoint()
    heard: list[bytes] = []
    with program(*LIVE, "--connect", endpoint) as run:
        run.wait_to_say("ready")
        with program(endpoint, script=ROUTER) as killed:
            killed.poses(1)
            with (
                program(*ROBOT, "--set", f"live.connect={endpoint}"),
                closing(open_transport(LiveParameters([endpoint], domain=0))) as other,
            ):
                other.subscribe(Topic("/localiser/pose", POSE), lambda content, source: heard.append(content))
                run.poses(COUNT)
                killed.end(signal.SIGKILL)
                run.wait_to_say("image: nothing")
                with program(endpoint, script=ROUTER):
                    run.rest()
                    heard.clear()
                    run.poses_at(LEAST_HZ, COUNT)
                    while not heard:
                        run.poses(1)
        ended(run)


def test_a_robot_that_is_killed_and_starts_again_and_one_more(network: Network) -> None:
    """Who takes another's place is followed; two at once are told."""
    with program(*LIVE, *network.arguments) as run:
        for _ in range(2):
            with program(*ROBOT, *network.arguments):
                run.poses_at(LEAST_HZ, COUNT)
            run.rest()
        assert not any("two publishers" in line for line in run.said)
        with program(*ROBOT, *network.arguments), program(*ROBOT, *network.arguments):
            run.wait_to_say("/odom: expected one publisher, found two")
        ended(run)


def test_a_flood(network: Network) -> None:
    """Images are located again at their rate; how soon, benchmarks/flood.py measures."""
    with program(*LIVE, *network.arguments) as run, program(*ROBOT, *network.arguments):
        run.poses(COUNT)
        make = Messages()
        content = make.encode(make.odometry(FAR_NS, ODOM, np.zeros(3)))
        with closing(open_transport(network.options)) as other:
            while not other.is_heard(WHEELS):
                time.sleep(0.01)
            for _ in range(FLOOD):
                other.publish(WHEELS, content)
        run.rest()
        run.poses_at(LEAST_HZ, COUNT)
        assert f"left out a message with the stamp {FAR_NS} ns" in ended(run)
