"""What is handed out holds what the project is and nothing else; its wheel works where nobody ever saw a clone."""

import csv
import json
import math
import re
import shutil
import subprocess
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import cv2
import pytest
from folders import ROOT
from installed import Installed, build
from short_log import CORRIDOR

from localiser.storage import ImageEvent, open_log, write_camera

STRAYS = (
    "logs/office/log.yaml",
    "maps/mine.yaml",
    "results/corridor/1/run.rrd",
    "drive.mcap",
    ".hypothesis/examples/a",
    "build/site/index.html",
    "localiser/geometry/__pycache__/a.pyc",
)
GENERATED = {"PKG-INFO"}


def tracked() -> set[str]:
    """Return the files of the project; skips where nobody can tell."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a clone")
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return {name for name in listed.stdout.splitlines() if (ROOT / name).is_file()}


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> tuple[set[str], set[str], set[str]]:
    """Return the project's files, those of the source archive and those of the wheel, built beside a user's files."""
    project, folder = tracked(), tmp_path_factory.mktemp("project")
    for name in project:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, folder / name)
    for name in STRAYS:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("a user's")
    archive, wheel = build(folder, tmp_path_factory.mktemp("dist"))
    with tarfile.open(archive) as source, zipfile.ZipFile(wheel) as built:
        inside = {"/".join(PurePosixPath(name).parts[1:]) for name in source.getnames()}
        return project, inside, set(built.namelist())


def test_the_source_archive_is_the_project(archives: tuple[set[str], set[str], set[str]]) -> None:
    project, source, _ = archives
    own = {name for name in project if not name.startswith(("logs/", "maps/")) or "corridor" in name}
    assert source - GENERATED == own


def test_the_wheel_is_the_package_and_the_example(archives: tuple[set[str], set[str], set[str]]) -> None:
    project, _, wheel = archives
    example = {name for name in project if name.startswith(("configs/", "logs/corridor/", "maps/corridor.yaml"))}
    package = {name for name in project if name.startswith("localiser/")}
    metadata = {name for name in wheel if ".dist-info/" in name}
    assert wheel - metadata == package | {f"localiser/example/{name}" for name in example}


def test_an_editable_installation_gets_no_second_example(tmp_path: Path) -> None:
    from hatchling.builders.wheel import WheelBuilder

    wheel = next(WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["editable"]))
    with zipfile.ZipFile(wheel) as built:
        assert not any("example" in name for name in built.namelist())


AHEAD_S = 0.3
"""By how much the wheels' clock is ahead of the video's."""


@pytest.fixture(scope="module")
def localiser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Installed]:
    folder = tmp_path_factory.mktemp("installed")
    yield Installed(folder)
    shutil.rmtree(folder)  # 1.5 GB, and pytest keeps the folders of three sessions


@pytest.mark.slow  # quick: tests/commands/test_demo.py and the tests above hold the parts
def test_the_first_quarter_of_an_hour(localiser: Installed, tmp_path: Path) -> None:
    """Demo with its files, live demo, and the first command that is documented for it."""
    where = [localiser.bin / "python", "-c", "import localiser; print(localiser.__file__)"]
    package = subprocess.run(
        where, cwd=tmp_path, env=localiser.environment(), capture_output=True, text=True, check=True
    )
    assert package.stdout.startswith(str(localiser.bin.parent))

    said = localiser("demo", "--keep", ".", cwd=tmp_path)
    assert "Next: `localiser view results/corridor/latest`" in said
    run = tmp_path / "results" / "corridor" / "1"
    assert json.loads((run / "metrics.json").read_text())["position_rmse_m"] < 0.02
    assert {"report.html", "report.png", "run.rrd"} <= {file.name for file in run.iterdir()}

    demo = [localiser.bin / "localiser", "live", "demo", "--json"]
    with subprocess.Popen(demo, cwd=tmp_path, env=localiser.environment(), stdout=subprocess.PIPE, text=True) as live:
        poses = [json.loads(live.stdout.readline()) for _ in range(10)]
        live.terminate()
    assert live.returncode == 0 and poses[-1]["p_correct"] > 0.9

    tilt = localiser("camera", "tilt", "logs/corridor", cwd=tmp_path)
    assert re.search(r"20\.0", tilt)


@pytest.mark.slow
@pytest.mark.parametrize("source", ["corridor", pytest.param("house", marks=pytest.mark.data)])
def test_a_video_of_ones_own(source: str, localiser: Installed, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """As the tutorials say: log, clocks, tilt, map, replay, report.

    The video has half the images of the log; the odometry is `t,x,y,yaw` by a clock that is 0.3 s ahead.
    """
    folder = CORRIDOR if source == "corridor" else request.getfixturevalue("data_dir") / source
    start_ns = film(folder, tmp_path)
    given = ("--camera", "camera.yaml", "--odometry", "odometry.csv", "--start-ns", start_ns)
    localiser("convert", "phone.mp4", "logs/filmed", *given, cwd=tmp_path)

    said = " ".join(localiser("camera", "sync", "logs/filmed", "-o", "logs/phone", cwd=tmp_path).split())
    offset_s, sigma_s = map(float, re.findall(r"(\d+\.\d+) s", said)[:2])
    assert abs(offset_s - AHEAD_S) < max(3 * sigma_s, 0.01) and "earlier than wheels" in said

    localiser("camera", "tilt", "logs/phone", cwd=tmp_path)
    built = ("--poses", "slam", "-o", "map.yaml", "--trajectory", "path.tum")
    localiser("map", "build", "logs/phone", *built, cwd=tmp_path)
    localiser("map", "show", "map.yaml", "-o", "map.png", cwd=tmp_path)
    localiser("replay", "logs/phone", "--map", "map.yaml", cwd=tmp_path)
    run = tmp_path / "results" / "phone" / "1"
    assert (run / "report.html").stat().st_size > 100_000 and (tmp_path / "map.png").exists()
    own = json.loads((run / "metrics.json").read_text())
    assert own["confidence"]["sure"] > 0.8 and own["edges_matched"] > 0.3

    judged = localiser("evaluate", "results/phone/1", "--truth", "path.tum", "--json", cwd=tmp_path)
    (figures,) = json.loads(judged).values()
    known = figures["confidence"]  # the log states no start: until the place is found, no pose is promised
    assert known["found_s"] < 10 and figures["position_rmse_m"] < 0.1
    assert known["sure_and_wrong"] < 0.02  # 0 with eight seeds; 2 of 209 images on another processor


def film(source: Path, folder: Path) -> int:
    """Write a video of every second image of a log, its camera and its odometry; return the time of the first image."""
    log = open_log(source)
    frames = [frame for frame in log.frames[::2] if isinstance(frame, ImageEvent)]
    rate_hz = 1e9 * (len(frames) - 1) / (frames[-1].t_ns - frames[0].t_ns)
    size = (log.camera.width, log.camera.height)
    video = cv2.VideoWriter(str(folder / "phone.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), rate_hz, size)
    for frame in frames:
        video.write(cv2.cvtColor(frame.load(), cv2.COLOR_GRAY2BGR))
    video.release()
    write_camera(log.camera, folder / "camera.yaml")
    with (folder / "odometry.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["t", "x", "y", "yaw"])
        for t_ns, (x, z, heading) in zip(log.odometry.t_ns, log.odometry.poses, strict=True):
            rows.writerow([f"{t_ns / 1e9 + AHEAD_S:.9f}", f"{x:.9f}", f"{-z:.9f}", f"{heading + math.pi / 2:.9f}"])
    return frames[0].t_ns
