"""Faults of the network that a live run gets over: its router goes away, the robot is started again, a flood."""

from __future__ import annotations

import json
import time
from contextlib import closing
from typing import Any

import pytest
from live_processes import LEAST_HZ, SETTINGS, START, free_endpoint, program
from short_log import CORRIDOR

from localiser.live import NetworkOptions, open_transport
from localiser.live.stand_in import WHEELS

zenoh = pytest.importorskip("zenoh")
pytestmark = pytest.mark.slow  # in part, without processes: test_transports.py, test_sources.py, test_senders.py

FLOOD = 40_000
COUNT = 5


def router(endpoint: str) -> Any:
    config = zenoh.Config()
    settings = {"mode": "router", "listen/endpoints": [endpoint], "scouting/multicast/enabled": False}
    for name, value in settings.items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)


def test_a_router_that_is_killed_a_robot_that_starts_again_and_a_flood() -> None:
    """After each, images are located again at the rate at which they come."""
    endpoint = free_endpoint()
    live = ("live", "--map", CORRIDOR / "map.yaml", "--connect", endpoint, "--start", START, "--json", *SETTINGS)
    robot = ("simulate", CORRIDOR, "--serve", "--connect", endpoint, "--odometry-hz", 50, "--quiet", "--wait")
    with program(*live) as run:
        run.wait_to_say("ready")
        session = router(endpoint)
        with program(*robot):
            run.poses(COUNT)
            session.close()
            session = router(endpoint)
            run.rest()
            run.poses_at(LEAST_HZ, COUNT)
        with program(*robot):
            run.poses_at(LEAST_HZ, COUNT)
            with closing(open_transport(NetworkOptions([endpoint]))) as other:
                while not other.is_heard(WHEELS):
                    time.sleep(0.01)
                for number in range(FLOOD):
                    other.publish(WHEELS, number.to_bytes(8, "little") * 90)
            run.rest()
            run.poses_at(LEAST_HZ, COUNT)
        run.end()
        said = run.all_said()
    session.close()
    assert "left out a message" in said and "Traceback" not in said
