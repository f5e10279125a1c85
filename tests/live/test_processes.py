"""Faults of a running robot, each with real processes. Bounds are wide: they tell a program that goes on from one that
does not, on any machine; how fast it is, is measured elsewhere.
"""

import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing
from os import kill
from pathlib import Path

import numpy as np
import pytest
from documented import blocks, commands
from folders import ROOT
from live_processes import LEAST_HZ, SETTINGS, START, Program, free_endpoint, program, wait_until
from short_log import CORRIDOR, Localiser

from localiser.config import LiveParameters
from localiser.live import open_transport
from localiser.ros import Topic
from localiser.storage import open_log, read_track
from localiser.storage.bags import RosType

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals and limits as Linux has them")

ROUTER = ROOT / "tests" / "support" / "zenoh_router.py"
DISK_BYTES = 1_000_000
IMAGES = 15
LIVE = ("live", "--map", CORRIDOR / "map.yaml", "--json", *SETTINGS)


@pytest.fixture(scope="module")
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture(scope="module")
def robot(endpoint: str) -> Iterator[Program]:
    with program("simulate", CORRIDOR, "--serve", "--set", f"live.listen={endpoint}") as running:
        running.wait_to_say("until Ctrl-C")
        yield running


@pytest.mark.slow
def test_a_run_that_is_killed_leaves_its_recording_and_comes_back(robot, endpoint, localiser, tmp_path):
    """The robot falls silent for a while as well."""
    bag, state = tmp_path / "drive.db3", tmp_path / "state"
    saving = ("--connect", endpoint, "--checkpoint", state)
    with program(*LIVE, *saving, "--start", START, "--record", bag) as live:
        lines = live.poses(5)
        robot.process.send_signal(signal.SIGSTOP)
        live.wait_to_say("image: nothing")
        robot.process.send_signal(signal.SIGCONT)
        live.wait_to_say("image: back")
        lines += live.poses(12)
        live.end(signal.SIGKILL)
        lines += live.rest()

    run = localiser.replay(bag, tmp_path / "results", few=False)
    track = read_track(run / "trajectory.csv")
    done = len(track.t_ns)
    expected = np.array([[line["x"], line["z"], line["heading"]] for line in lines[:done]])
    np.testing.assert_allclose(track.poses[: len(expected)], expected, rtol=0, atol=1e-9)
    lost_s = (lines[-1]["t_ns"] - int(track.t_ns[-1])) / 1e9
    assert lost_s < 3.0, "a second, and what a busy machine adds to it"

    with program(*LIVE, *saving) as live:
        lines = live.poses(5)
        live.wait_to_say("resumed; the wheels tell")
        lines += live.poses(45)  # a busy machine loses images around the silence, so that the state is less sure
        assert max(line["p_correct"] for line in lines) > 0.7 and min(line["cov"][0] for line in lines) < 0.2
        assert live.end() == 0


@pytest.mark.slow
def test_a_viewer_that_is_frozen_and_then_killed_changes_nothing(robot: Program, endpoint: str) -> None:
    """Its page is opened by nobody either."""
    with program(*LIVE, "--connect", endpoint, "--start", START, "--view", "web") as live:
        live.wait_to_say("Watch at")
        live.poses_at(LEAST_HZ, IMAGES)
        viewers = live.children()
        assert viewers
        for viewer in viewers:
            kill(viewer, signal.SIGSTOP)
        live.poses_at(LEAST_HZ, IMAGES)
        for viewer in viewers:
            kill(viewer, signal.SIGKILL)
        live.poses_at(LEAST_HZ, IMAGES)
        assert live.end() == 0
    assert "Traceback" not in live.all_said()


@pytest.mark.slow  # quick: tests/view/test_view.py kills a run with a viewer
def test_the_stand_in_does_not_outlive_a_demo_that_is_killed() -> None:
    with program("live", "demo", CORRIDOR, "--json", *SETTINGS) as live:
        live.poses(1)
        commands = [Path(f"/proc/{child}/cmdline") for child in live.children()]
        assert any(b"--serve" in command.read_bytes() for command in commands)
        live.end(signal.SIGKILL)
    wait_until(lambda: not any(command.exists() and command.read_bytes() for command in commands))


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 1 MB, or a folder where that cannot be had."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(folder)]
    mounted = shutil.which("mount") is not None and subprocess.run(mount, check=False, capture_output=True)
    yield folder
    if mounted and mounted.returncode == 0:
        subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.slow  # quick: tests/live/test_publishing.py has a database that is full
def test_a_full_disk_ends_the_recording_and_not_the_run(robot: Program, endpoint: str, small_disk: Path) -> None:
    bag = small_disk / "drive.db3"
    limit = None if small_disk.is_mount() else DISK_BYTES  # of files, which fails as a full disk does
    arguments = ("--connect", endpoint, "--start", START, "--record", bag)
    with program(*LIVE, *arguments, largest_file=limit) as live:
        live.wait_to_say("The recording ended, the run goes on")
        live.rest()
        live.poses_at(LEAST_HZ, IMAGES)
        assert live.end() == 0
    assert "Traceback" not in live.all_said()
    assert len(open_log(bag).frames) > 1


@pytest.mark.slow  # quick, without processes: test_transports.py
def test_a_router_that_is_killed_and_comes_back() -> None:
    """Images are located again at the rate at which they come, and the poses go out again to who listened before."""
    endpoint = free_endpoint()
    heard: list[bytes] = []
    with program(*LIVE, "--start", START, "--connect", endpoint) as run:
        run.wait_to_say("ready")
        with program(endpoint, script=ROUTER) as killed:
            killed.poses(1)
            with (
                program("simulate", CORRIDOR, "--serve", "--set", f"live.connect={endpoint}"),
                closing(open_transport(LiveParameters([endpoint], domain=0))) as other,
            ):
                other.subscribe(Topic("/localiser/pose", RosType.POSE), lambda content, source: heard.append(content))
                run.poses(IMAGES)
                killed.end(signal.SIGKILL)
                run.wait_to_say("image: nothing")
                with program(endpoint, script=ROUTER):
                    run.rest()
                    heard.clear()
                    run.poses_at(LEAST_HZ, IMAGES)
                    while not heard:
                        run.poses(1)
        run.end()
    assert "Traceback" not in run.all_said()


@pytest.mark.slow  # quick: tests/live/test_run.py states one to the same loop
def test_a_pose_is_stated_from_outside(robot: Program, endpoint: str, localiser: Localiser) -> None:
    with program(*LIVE, "--connect", free_endpoint(), "--connect", endpoint) as live:  # one is not there
        live.poses(1)
        result = localiser("pose", "set", "2,-3,45", "--set", f"live.connect={endpoint}")
        assert result.exit_code == 0, result.err
        live.wait_to_say("started at x = 2.00 m, z = -3.00 m, heading = 45.0°")
        assert live.end(signal.SIGINT) == 0


@pytest.mark.slow  # quick: tests/live/test_fuzz.py and tests/commands/test_main.py run it in part
def test_doctor_hears_the_robot(robot: Program, endpoint: str, localiser: Localiser) -> None:
    result = localiser("doctor", "--set", f"live.connect={endpoint}", "--seconds", 2)
    assert result.exit_code == 0, result.out
    assert "stated" in result.out and "/odom" in result.out


@pytest.mark.slow  # quick, without its exit code: tests/live/test_status.py
def test_a_run_that_hears_nothing_says_what_to_do_and_ends_with_1() -> None:
    endpoint = free_endpoint()
    with program(*LIVE, "--connect", endpoint) as live:
        live.wait_to_say("nothing heard yet of image")
        assert live.end() == 1
    assert f"at {endpoint}, domain 0; no zenoh router answers there: start one" in live.all_said()


@pytest.mark.slow
def test_who_does_not_listen_is_told(localiser: Localiser) -> None:
    result = localiser("pose", "set", "1,2,3", "--set", f"live.connect={free_endpoint()}")
    assert result.exit_code == 2 and "can be reached" in result.err


PAGE = ROOT / "docs" / "tutorials" / "fleet.md"
ON_PAGE = "tcp/127.0.0.1:7447"


@pytest.mark.slow
def test_the_page_runs_as_it_is_written(localiser: Localiser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In its order, but for the port of the router and the number of particles; each run follows its robot."""
    monkeypatch.chdir(tmp_path)
    for part in ("logs", "maps"):
        shutil.copytree(ROOT / part, tmp_path / part)
    endpoint = free_endpoint()
    (site,) = (block.text for block in blocks(PAGE) if block.language == "yaml")
    (tmp_path / "site.yaml").write_text(site.replace(ON_PAGE, endpoint))
    ran = []
    with ExitStack() as stack:
        runs = []
        for written in commands(PAGE):
            words = [word.replace(ON_PAGE, endpoint) for word in written]
            if words[0] == "simulate":
                stack.enter_context(program(*words)).wait_to_say("until Ctrl-C")
            elif words[0] == "live":
                runs.append(stack.enter_context(program(*words, "--json", *SETTINGS)))
                runs[-1].poses(3)
            else:
                if words[0] == "batch":
                    assert [run.end(signal.SIGINT) for run in runs] == [0, 0, 0]
                result = localiser(*words)
                assert result.exit_code == 0, result.out + result.err
            ran.append(words[0])
    assert ran == ["simulate", "simulate", "doctor", "live", "live", "pose", "simulate", "live", "batch"]
