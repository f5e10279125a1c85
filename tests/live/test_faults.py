"""What goes wrong between a robot and the program, with real processes: a run goes on, at its rate, and is not lost.

Rates are by the stamps of the images, and a machine that is busy for a while is waited for: at half the images and
without wheels a robot is followed less well, so that only images count before which none was left out.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from folders import ROOT
from live_processes import LEAST_HZ, SETTINGS, START, Program, free_endpoint, program
from short_log import CORRIDOR

from localiser.geometry import Trajectory

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="signals as Linux has them"),
    pytest.mark.slow,  # the same faults without processes: test_run.py, test_fuzz.py
]

ROBOT = ROOT / "tests" / "support" / "live_faulty_robot.py"
IMAGES = 16
SETTLED = 12
"""So many images, at the robot's rate, go before those that are judged: what a busy machine left out is made up for."""

STOPPED_S = 10.0
FOUND_IMAGES = 60
"""After a stop the robot is sure of its place again within so many images."""

WORST_M = 0.15
NOTICED = {
    "duplicated": "came twice",
    "reordered": "late",
    "in the future": "cannot be true",
    "corrupt": "damaged",
    "junk": "left out a message",
    "no odometry": "odometry: nothing",
}
"""What is said of each fault, or counted at the end."""


@pytest.fixture(scope="module")
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture(scope="module")
def robot(endpoint: str) -> Iterator[Program]:
    with program(CORRIDOR, endpoint, script=ROBOT) as running:
        yield running


@pytest.fixture(scope="module")
def happened() -> list[str]:
    """The faults that there were so far."""
    return []


@pytest.fixture(scope="module")
def live(robot: Program, endpoint: str, happened: list[str]) -> Iterator[Program]:
    start = START
    arguments = ("--map", CORRIDOR / "map.yaml", "--json", "--connect", endpoint, "--start", start)
    with program("live", *arguments, *SETTINGS) as running:
        while running.poses(1)[0].get("error_m", 1.0) > WORST_M:  # the robot drove on while the program started
            pass
        yield running
        assert running.end() == 0
        said = running.all_said()
        assert "Traceback" not in said
        assert all(NOTICED[fault] in said for fault in happened), said


@pytest.mark.parametrize("fault", NOTICED)
def test_messages_that_go_wrong(robot: Program, live: Program, fault: str, happened: list[str]) -> None:
    """For five seconds: one of eight images and of three poses of the wheels, or all of the latter not there."""
    robot.tell("")
    live.poses(3)
    robot.tell(fault)
    happened.append(fault)
    live.poses(1)
    lines = live.poses_at(LEAST_HZ, SETTLED + IMAGES)
    robot.tell("")
    assert (np.diff([line["t_ns"] for line in lines]) > 0).all(), "none twice, and in their order"
    assert_right(lines, robot, is_sure=fault != "no odometry")
    assert max(line["stamp_ns"] for line in lines) < time.time_ns() + 10**9


def test_a_source_that_stops_for_ten_seconds_and_comes_back(robot: Program, live: Program) -> None:
    robot.tell("")
    live.poses(1)
    robot.process.send_signal(signal.SIGSTOP)
    live.wait_to_say("odometry: nothing")
    time.sleep(STOPPED_S)
    live.rest()
    robot.process.send_signal(signal.SIGCONT)
    live.poses(3)  # what it sends late is left out by it
    for _ in range(FOUND_IMAGES):  # five metres of the way are known by one step of the wheels
        if live.poses(1)[0]["p_correct"] > 0.9:
            break
    lines = live.poses_at(LEAST_HZ, SETTLED + IMAGES)
    assert_right(lines, robot)


def assert_right(lines: list[dict[str, Any]], robot: Program, *, is_sure: bool = True) -> None:
    """The robot writes its true poses. is_sure: whether it must say so; without odometry it need not."""
    judged = lines[SETTLED:]
    truth = robot.rest()
    while truth[-1]["t_ns"] < judged[-1]["stamp_ns"]:
        truth += robot.poses(1)
    true_poses = Trajectory(np.array([row["t_ns"] for row in truth]), np.array([row["pose"] for row in truth]))
    true_x, true_z, _ = true_poses.sampled([line["stamp_ns"] for line in judged]).poses.T
    errors_m = np.hypot([line["x"] for line in judged] - true_x, [line["z"] for line in judged] - true_z)
    assert not is_sure or np.median([line["p_correct"] for line in judged]) > 0.9
    assert np.median(errors_m) < WORST_M
