"""`localiser doctor` and `localiser pose set`; a replay that is held back to be watched."""

import subprocess
import sys
from importlib import metadata
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

import pytest
from live_transport import KeepingTransport
from short_log import CORRIDOR, Localiser, cut_log
from small_bag import Recorder, bag, recording
from small_log import write_edge_log

from localiser import live
from localiser.commands import doctor_checks, pose
from localiser.commands.options import paced
from localiser.config import LiveParameters
from localiser.storage.bags import floor_pose


def test_a_plain_installation_lacks_nothing(localiser: Localiser, monkeypatch: pytest.MonkeyPatch) -> None:
    """zenoh and DDS are extras, for a running robot."""

    def version(name: str) -> str:
        if name in doctor_checks.OF_A_ROBOT:
            raise metadata.PackageNotFoundError(name)
        return "1.0"

    monkeypatch.setattr(metadata, "version", version)
    result = localiser("doctor")
    assert result.exit_code == 0
    assert "optional" in result.out and "pip install '.[live]'" in result.out and "missing" not in result.out


@pytest.mark.parametrize("package", ["zenoh", "xxhash"])
def test_a_package_of_the_extra_that_lacks_is_told(package: str) -> None:
    code = f"import sys; sys.modules[{package!r}] = None; from localiser.commands.main import main; main()"
    words = ["pose", "set", "1,2,3", "--set", "live.connect=tcp/127.0.0.1:9"]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "pip install '.[live]'" in done.stderr and "Traceback" not in done.stderr


def test_a_log_that_has_all_is_ready_and_one_with_a_damaged_image_is_not(localiser: Localiser, tmp_path: Path) -> None:
    result = localiser("doctor", CORRIDOR)
    assert result.exit_code == 0
    rows = {row.split()[1]: " ".join(row.split()) for row in result.out.splitlines()}
    assert "640×480 pixels, 0.90 m high, tilt 20.0°" in rows["camera"]
    assert "5.0 Hz" in rows["images"] and "20.0 Hz" in rows["odometry"]
    assert rows["tilt"].startswith("ok") and rows["map"].startswith("ok")
    log = cut_log(CORRIDOR, tmp_path / "log", 2)
    (log / "images" / "000001.jpg").write_bytes((log / "images" / "000001.jpg").read_bytes()[:3000])
    result = localiser("doctor", log)
    assert result.exit_code == 1 and "ok camera" in (said := " ".join(result.out.split()))
    assert "missing replay" in said and "images.csv:3: file:" in said and "expected a whole image" in said


def test_a_log_of_edges_without_a_map_lacks_that(localiser: Localiser, tmp_path: Path) -> None:
    path = write_edge_log(tmp_path / "edges")
    text = (path / "log.yaml").read_text()
    (path / "log.yaml").write_text("".join(line for line in text.splitlines(True) if not line.startswith("map:")))
    result = localiser("doctor", path)
    assert result.exit_code == 1
    assert f"localiser map build {path} -o map.yaml" in " ".join(result.out.split())


def record(recorder: Recorder) -> None:
    for k in range(10):
        recorder.image(k * 10**8 if k < 5 else k * 10**8 + 3 * 10**9, recorded_ns=k * 10**8 + 4 * 10**9)
    recorder.image(0, topic="/other/image")


def test_a_bag_is_told_topic_by_topic_and_what_to_choose(localiser: Localiser, tmp_path: Path) -> None:
    path = bag(tmp_path / "drive.mcap", record)
    result = localiser("doctor", path)
    said = " ".join(result.out.split())
    assert result.exit_code == 1 and "choose with --topic image=/cam/image" in said
    assert "/cam/image 10 × sensor_msgs/msg/Image, 10.0 Hz; 1 gap, the longest of 3.1 s after 0.4 s" in said
    assert "/odom 11 × nav_msgs/msg/Odometry, 10.0 Hz; stamps are 0.000 s older than the recording" in said
    assert "/other/image 1 × sensor_msgs/msg/Image; headers without stamps" in said
    result = localiser("doctor", path, "--topic", "image=/cam/image")
    said = " ".join(result.out.split())
    assert "camera 8×6 pixels, 0.70 m high" in said and "does not reach 5 of 10 images, in which" in said
    assert "no vertical edge in any image" in said
    assert result.exit_code == 1 and "missing map none: `localiser map build" in said


def test_what_a_bag_lacks_is_told_with_how_to_give_it(localiser: Localiser, tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with recording(path) as recorder:
        for k in range(11):
            recorder.image(k * 10**8)
            recorder.odometry(k * 10**8)
    result = localiser("doctor", path)
    said = " ".join(result.out.split())
    assert result.exit_code == 1 and "give camera and mount with --camera FILE" in said


@pytest.mark.parametrize("frame", ["map", "world"])
def test_a_pose_names_the_frame_of_the_map(frame: str, monkeypatch: pytest.MonkeyPatch) -> None:
    transport = KeepingTransport()
    monkeypatch.setattr(live, "open_transport", lambda *_, **__: transport)
    monkeypatch.setattr(pose, "PAUSE_S", 0.0)
    assert pose.send_pose("1,2,90", "0.1,3", LiveParameters(map_frame=frame, namespace="robot1")) == (
        "/robot1/initialpose"
    )
    message = transport.messages("/robot1/initialpose")[-1]
    assert message.header.frame_id == frame and floor_pose(message)[:2] == (1.0, 2.0)


def test_images_pass_at_the_speed_they_were_taken_times_a_factor() -> None:
    """By a clock of our own: work takes 10 ms an image, waiting takes the rest."""
    now = [100.0]
    passed = []

    def sleep(seconds: float) -> None:
        now[0] += seconds

    def advance() -> None:
        now[0] += 0.01
        passed.append(now[0])

    times_ns = [7_000_000_000 + k * 200_000_000 for k in range(5)]
    with patch("time.monotonic", lambda: now[0]), patch("time.sleep", sleep):
        step = paced(advance, times_ns, speed=2.0)
        for _ in times_ns:
            step()
    assert [round(later - sooner, 6) for sooner, later in pairwise(passed)] == [0.11, 0.1, 0.1, 0.1]
    paced(advance, [0, 10**10], speed=float("inf"))()
