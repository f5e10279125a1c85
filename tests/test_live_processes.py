"""Faults of a running robot, each with real processes. Bounds are wide: they tell a program that goes on from one that
does not, on any machine; how fast it is, is measured elsewhere.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from os import kill
from pathlib import Path

import numpy as np
import pytest
from live_processes import SETTINGS, Program, free_endpoint, program
from short_log import CORRIDOR, Localiser

from localiser.storage import load_track, open_log

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals and limits as Linux has them")

LIVE = ("live", "--map", CORRIDOR / "map.yaml", "--json", *SETTINGS)


@pytest.fixture(scope="module")
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture(scope="module")
def robot(endpoint: str) -> Iterator[Program]:
    with program("simulate", CORRIDOR, "--serve", "--listen", endpoint, "--odometry-hz", 50) as running:
        running.wait_to_say("until Ctrl-C")
        yield running


def test_a_run_that_is_killed_leaves_its_recording_and_comes_back(
    robot: Program, endpoint: str, localiser: Localiser, tmp_path: Path
) -> None:
    """The robot falls silent for a while as well."""
    bag, state = tmp_path / "drive.db3", tmp_path / "state"
    saving = ("--connect", endpoint, "--checkpoint", state)
    with program(*LIVE, *saving, "--record", bag) as live:
        lines = live.poses(5)
        robot.process.send_signal(signal.SIGSTOP)
        live.wait_to_say("image: nothing")
        robot.process.send_signal(signal.SIGCONT)
        live.wait_to_say("image: back")
        lines += live.poses(12)
        live.end(signal.SIGKILL)
        lines += live.rest()

    run = localiser.replay(bag, tmp_path / "results")
    track = load_track(run / "trajectory.csv")
    done = len(track.t_ns)
    expected = np.array([[line["x"], line["z"], line["heading"]] for line in lines[:done]])
    np.testing.assert_allclose(track.poses[: len(expected)], expected, rtol=0, atol=1e-9)
    lost_s = (lines[-1]["t_ns"] - int(track.t_ns[-1])) / 1e9
    assert lost_s < 3.0, "a second, and what a busy machine adds to it"

    with program(*LIVE, *saving, "--resume") as live:
        lines = live.poses(5)
        live.wait_to_say("resumed; the wheels tell")
        assert max(line["p_correct"] for line in lines) > 0.7 and min(line["cov"][0] for line in lines) < 0.2
        assert live.end() == 0


def test_a_full_disk_and_a_frozen_viewer_do_not_stop_a_run(robot: Program, endpoint: str, tmp_path: Path) -> None:
    arguments = ("--connect", endpoint, "--start", start(), "--record", tmp_path / "drive.db3", "--view", "web")
    with program(*LIVE, *arguments, largest_file=1_000_000) as live:
        live.poses(2)
        live.wait_to_say("Watch at")
        viewers = live.children()
        assert viewers
        for viewer in viewers:
            kill(viewer, signal.SIGSTOP)
        live.wait_to_say("The recording ended, the run goes on")
        live.rest()
        live.poses(6)
        for viewer in viewers:
            kill(viewer, signal.SIGKILL)
        live.rest()
        live.poses(4)
        assert live.end() == 0
    assert not any("Traceback" in line for line in live.said)
    assert len(open_log(tmp_path / "drive.db3").frames) > 1


def start() -> str:
    where = open_log(CORRIDOR).start
    assert where is not None
    return f"{where.mean[0]},{where.mean[1]},{np.rad2deg(where.mean[2])}"


def test_a_pose_is_stated_from_outside(robot: Program, endpoint: str, localiser: Localiser) -> None:
    with program(*LIVE, "--connect", free_endpoint(), "--connect", endpoint) as live:  # one is not there
        live.poses(1)
        result = localiser("pose", "set", "2,-3,45", "--connect", endpoint)
        assert result.exit_code == 0, result.err
        live.wait_to_say("started at x = 2.00 m, z = -3.00 m, heading = 45.0°")
        assert live.end(signal.SIGINT) == 0


def test_doctor_hears_the_robot(robot: Program, endpoint: str, localiser: Localiser) -> None:
    result = localiser("doctor", "--connect", endpoint, "--seconds", 2, "--map", CORRIDOR / "map.yaml", "--at", "0,0")
    assert result.exit_code == 0, result.out
    assert "stated" in result.out and "landmarks in view" in result.out and "/odom" in result.out


def test_who_does_not_listen_is_told(localiser: Localiser) -> None:
    result = localiser("pose", "set", "1,2,3", "--connect", free_endpoint())
    assert result.exit_code == 2 and "can be reached" in result.err
