"""The commands about the camera: what they print and write, and how they say that something is wrong."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from board_views import board_image, floor_pose, poses_before
from edge_images import camera_of
from PIL import Image
from short_log import CORRIDOR, FEW_PARTICLES, FRAMES, Localiser, cut_log
from small_log import write_edge_log, write_small_log

from localiser.calibration import Board, calibrate
from localiser.commands.doctor_checks import offset_finding
from localiser.edges import find_edges
from localiser.errors import InputError
from localiser.storage import open_log, read_camera


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log whose camera file states a tilt that is 3° off, with comments."""
    folder = cut_log(CORRIDOR, tmp_path / "log", FRAMES)
    text = (folder / "camera.yaml").read_text()
    (folder / "camera.yaml").write_text(text.replace("tilt_deg: 20.0", "tilt_deg: 17.0") + "# measured by hand\n")
    return folder


# -- tilt -------------------------------------------------------------------------------------------------------------


def test_tilt_prints_what_is_stated_and_what_is_found(localiser: Localiser, log: Path) -> None:
    before = (log / "camera.yaml").read_bytes()
    result = localiser("camera", "tilt", log)
    assert result.exit_code == 0
    rows = {line.split()[0]: line.split()[2:] for line in result.out.splitlines() if "°" in line}
    stated, found, sigma, difference = (float(text) for text in rows["tilt"])
    assert stated == 17.0 and abs(found - 20.0) < 0.1 and sigma < 0.1  # of six images
    assert difference == pytest.approx(found - stated, abs=0.001)
    assert (log / "camera.yaml").read_bytes() == before


def test_a_log_with_the_tilt_that_was_found_is_written_to_a_new_folder(localiser, log, tmp_path):
    before = {file: file.read_bytes() for file in log.rglob("*") if file.is_file()}
    out = tmp_path / "levelled"
    result = localiser("camera", "tilt", log, "-o", out)
    assert result.exit_code == 0 and str(out) in result.out
    assert {file: file.read_bytes() for file in log.rglob("*") if file.is_file()} == before
    old, new = open_log(log), open_log(out)
    assert new.camera.mount.tilt_rad == pytest.approx(np.deg2rad(20.0), abs=np.deg2rad(0.1))
    assert new.camera.mount.height_m == old.camera.mount.height_m and new.camera.fx == old.camera.fx
    assert [image.encoded() for image in new.images] == [image.encoded() for image in old.images]
    again = localiser("camera", "tilt", log, "-o", out)
    assert again.exit_code == 2 and "expected a new or empty folder" in again.err
    assert "tilt (°)" not in again.out, "it is told before the work"


def test_images_without_edges_are_told_and_not_written(localiser: Localiser, tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log")  # noise only
    before = (log / "camera.yaml").read_bytes()
    result = localiser("camera", "tilt", log)
    assert result.exit_code == 0 and "hardly tell the tilt" in result.err
    result = localiser("camera", "tilt", log, "-o", tmp_path / "out")
    assert result.exit_code == 2 and "not written" in result.err and str(log) in result.err
    assert (log / "camera.yaml").read_bytes() == before and not (tmp_path / "out").exists()


# -- sync -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shifted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A corner of the corridor, in 9 s of which the robot turns by 100°; the images are stamped 0.4 s late."""
    folder = tmp_path_factory.mktemp("shifted") / "log"
    cut_log(CORRIDOR, folder, 0)
    header, *rows = (CORRIDOR / "images.csv").read_text().splitlines()
    shutil.copytree(CORRIDOR / "images", folder / "images", dirs_exist_ok=True)
    times, names = zip(*(row.split(",") for row in rows[85:130]), strict=True)
    moved = [f"{int(t_ns) + 400_000_000},{name}" for t_ns, name in zip(times, names, strict=True)]
    (folder / "images.csv").write_text("\n".join([header, *moved]) + "\n")
    return folder


def offset_told(text: str) -> tuple[float, float]:
    """Return offset and sigma that a text tells, later being positive."""
    (found,) = re.findall(r"stamped ([\d.]+) s ± ([\d.]+) s (later|earlier) than", text)
    return float(found[0]) * (1 if found[2] == "later" else -1), float(found[1])


def test_sync_tells_the_offset_and_writes_a_log_without_it(localiser: Localiser, shifted: Path, tmp_path: Path) -> None:
    before, out = (shifted / "images.csv").read_text(), tmp_path / "log"
    offset_s, sigma_s = offset_told(localiser("camera", "sync", shifted).out)
    assert abs(offset_s - 0.4) < 3 * sigma_s < 0.15
    result = localiser("camera", "sync", shifted, "-o", out, "--quiet")
    assert result.exit_code == 0 and result.err == "" and str(out) in result.out
    assert (shifted / "images.csv").read_text() == before
    again_s, _ = offset_told(again := localiser("camera", "sync", out).out)
    assert abs(again_s) < sigma_s
    moved_ns = [new.t_ns - old.t_ns for new, old in zip(open_log(out).images, open_log(shifted).images, strict=True)]
    assert moved_ns == pytest.approx([-offset_s * 1e9] * len(moved_ns), abs=1e6)
    header, *rows = (out / "images.csv").read_text().splitlines()
    panned = [f"{header},yaw_deg", *(f"{row},{k % 7}" for k, row in enumerate(rows))]
    (out / "images.csv").write_text("\n".join(panned) + "\n")
    assert localiser("camera", "sync", out).out != again, "what a head is said to pan is no turn of the robot"


def test_an_offset_that_nothing_tells_is_not_written(localiser: Localiser, tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log")  # two tenths of a second
    result = localiser("camera", "sync", log)
    assert result.exit_code == 0 and "hardly tells the offset" in result.err
    result = localiser("camera", "sync", log, "-o", tmp_path / "out")
    assert result.exit_code == 2 and "not written" in result.err and str(log) in result.err
    assert not (tmp_path / "out").exists()
    result = localiser("camera", "sync", write_edge_log(tmp_path / "edges"))
    assert result.exit_code == 2 and "expected a log with images" in result.err


@pytest.mark.slow  # quick: tests/calibration/test_clock.py and `camera sync` below
def test_replay_and_map_build_warn_of_clocks_that_differ(localiser: Localiser, shifted: Path, tmp_path: Path) -> None:
    result = localiser("replay", shifted, "--out", tmp_path / "out", "--no-rrd", "--start", "truth", *FEW_PARTICLES)
    assert result.exit_code == 0
    (text,) = re.findall(r"The images are stamped .*?camera sync", result.err)
    offset_s, sigma_s = offset_told(text)
    assert abs(offset_s - 0.4) < 3 * sigma_s < 0.15
    (metrics,) = (tmp_path / "out").glob("*/1/metrics.json")
    figures = json.loads(metrics.read_text())
    assert figures["clock_offset_s"] == pytest.approx(offset_s, abs=0.001)
    assert figures["clock_offset_sigma_s"] == pytest.approx(sigma_s, abs=0.001)
    assert any(f"camera sync {shifted}" in warning for warning in figures["warnings"])
    built = localiser("map", "build", shifted, "--poses", "odometry", "-o", tmp_path / "map.yaml", "--quiet")
    assert built.exit_code == 2 and "poses do not fit" in built.err, "and it is told what may be the reason"
    offset_s, sigma_s = offset_told(built.err)
    assert abs(offset_s - 0.4) < 3 * sigma_s < 0.15


def test_doctor_tells_the_offset_of_clocks(shifted: Path) -> None:
    log = open_log(shifted)
    frames = [find_edges(frame.load(), log.camera) for frame in log.frames]
    times = [frame.t_ns for frame in log.frames]
    finding = offset_finding(times, frames.__getitem__, log.odometry, log.camera)
    assert finding.state == "warning" and abs(offset_told(finding.text)[0] - 0.4) < 0.05
    finding = offset_finding(times[:3], frames.__getitem__, log.odometry, log.camera)
    assert finding.state == "ok" and "must turn" in finding.text


# -- replay -----------------------------------------------------------------------------------------------------------


def test_replay_warns_once_when_edges_contradict_the_stated_tilt(localiser, log, tmp_path):
    result = localiser("replay", log, "--out", tmp_path / "out", "--no-rrd", *FEW_PARTICLES)
    assert result.exit_code == 0 and result.err.count(f"localiser camera tilt {log}") == 1
    (metrics,) = (tmp_path / "out").glob("*/1/metrics.json")
    figures = json.loads(metrics.read_text())
    assert abs(figures["tilt_found_deg"] - 20.0) < 0.3 and len(figures["warnings"]) == 1
    run = localiser.replay(log, tmp_path / "quiet")  # which demands an empty stderr
    assert json.loads((run / "metrics.json").read_text())["warnings"] == figures["warnings"]


# -- calibrate --------------------------------------------------------------------------------------------------------

CAMERA = camera_of(480, 360, tilt_deg=35.0, roll_deg=-1.5, k1=-0.2)
BOARD = Board("charuco", 8, 6, 0.1, 0.075)
OPTIONS = ("--board", "charuco", "--squares", "8x6", "--square-m", "0.1")


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Four views of a board, the last of them on the floor."""
    folder = tmp_path_factory.mktemp("board")
    poses = [*poses_before(BOARD, 3, seed=5), floor_pose(CAMERA, BOARD, 1.3)]
    paths = [folder / f"{index}.png" for index in range(len(poses))]
    for seed, (path, pose) in enumerate(zip(paths, poses, strict=True)):
        cv2.imwrite(str(path), board_image(CAMERA, BOARD, pose, seed=seed))
    return paths


def test_calibrated_camera_file_is_read_back(localiser: Localiser, images: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "camera.yaml"
    result = localiser("camera", "calibrate", *images[:3], "--floor", images[3], *OPTIONS, "-o", out)
    assert result.exit_code == 0, result.err
    for text in ("0.png", "3.png", "error (px)", "fx (px)", "k1", "tilt (°)", "height (m)"):
        assert text in result.out
    camera = read_camera(out)
    assert camera.name == "camera" and camera.fx == pytest.approx(CAMERA.fx, rel=0.02)
    assert camera.mount.tilt_rad == pytest.approx(CAMERA.mount.tilt_rad, abs=np.deg2rad(0.5))
    assert camera.mount.height_m == pytest.approx(CAMERA.mount.height_m, abs=0.02)
    again = localiser("camera", "calibrate", *images, *OPTIONS, "-o", out)
    assert again.exit_code == 2 and "expected a new file" in again.err


def test_without_floor_the_mount_is_asked_for(localiser: Localiser, images: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "camera.yaml"
    result = localiser("camera", "calibrate", *images, *OPTIONS, "-o", out, "--quiet")
    assert result.exit_code == 0 and "no mount yet" in result.err
    with pytest.raises(InputError, match="mount"):
        read_camera(out)


def test_a_lens_that_folds_in_the_image_is_not_written(localiser, images, tmp_path, monkeypatch):
    folds = replace(CAMERA, distortion=(-0.9, 0.0, 0.0, 0.0, 0.0))
    monkeypatch.setattr("localiser.calibration.calibrate", lambda *given: replace(calibrate(*given), camera=folds))
    result = localiser("camera", "calibrate", *images, *OPTIONS, "-o", tmp_path / "c")
    assert result.exit_code == 2 and "undone up to the image's border" in result.err and not (tmp_path / "c").exists()


def test_images_without_the_board_are_listed_and_too_few_refused(localiser, images, tmp_path):
    blank = tmp_path / "blank.png"
    cv2.imwrite(str(blank), np.full((360, 480), 90, dtype=np.uint8))
    result = localiser("camera", "calibrate", *images, blank, *OPTIONS)
    assert result.exit_code == 0
    assert "no board found" in next(line for line in result.out.splitlines() if "blank.png" in line)
    assert "No board was found in blank.png" in result.err
    for arguments, problem in (
        ((blank, blank), "found it in none"),
        ((*images[:2], blank), "at least 3 images, found it in 2 and not in blank.png; --squares counts squares"),
        ((*images, "--floor", blank), f"{blank}: expected a charuco of 8x6 squares"),
    ):
        result = localiser("camera", "calibrate", *arguments, *OPTIONS)
        assert result.exit_code == 2 and problem in result.err.replace("\n", " "), result.err
    listed = [localiser("camera", "calibrate", *order, *OPTIONS).out for order in (images, [*images[::-1], images[0]])]
    assert listed[0] == listed[1], "images are taken once, and in the order of their names"


@pytest.mark.parametrize(
    ("content", "problem"),
    [(b"", "an empty file"), (b"no image", "expected a JPEG or PNG"), (None, "no such file"), ("small", "found 64×48")],
)
def test_images_that_cannot_be_used_are_named(localiser, images, tmp_path, content, problem):
    bad = tmp_path / "bad.png"
    if isinstance(content, bytes):
        bad.write_bytes(content)
    elif content is not None:
        cv2.imwrite(str(bad), np.zeros((48, 64), dtype=np.uint8))
    result = localiser("camera", "calibrate", images[0], bad, *OPTIONS)
    assert result.exit_code == 2 and str(bad) in result.err and problem in result.err


@pytest.mark.parametrize("squares", ["8", "8x", "axb", "8x6x4", "2x2"])
def test_squares_are_columns_and_rows(localiser: Localiser, images: list[Path], squares: str) -> None:
    options = ("--board", "charuco", "--squares", squares, "--square-m", "0.1")
    result = localiser("camera", "calibrate", *images, *options)
    assert result.exit_code == 2 and "--squares: expected" in result.err


def test_drawn_board_is_found_again(localiser: Localiser, tmp_path: Path) -> None:
    options = ("--board", "charuco", "--squares", "5x4", "--square-m", "0.01")
    draw = ("camera", "calibrate", *options, "--draw-board")
    assert localiser(*draw, tmp_path / "board.png").exit_code == 0
    picture = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    small = cv2.resize(picture, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    board = Board("charuco", 5, 4, 0.01, 0.0075)
    view = board.find(small)
    assert view is not None and len(view.corners_px) == (board.columns - 1) * (board.rows - 1)
    with Image.open(tmp_path / "board.png") as drawn:  # at its true size: 5 squares of 1 cm, and half of one around
        assert drawn.width / drawn.info["dpi"][0] * 0.0254 == pytest.approx(0.06, rel=1e-3)
    assert localiser(*draw, tmp_path / "board.png").exit_code == 2
    assert localiser(*draw, tmp_path / "board.doc").exit_code == 2
    assert "--marker-m: expected markers" in localiser(*draw, tmp_path / "b.png", "--marker-m", "0.0001").err
    assert "expected images of the board" in localiser("camera", "calibrate", *options).err
