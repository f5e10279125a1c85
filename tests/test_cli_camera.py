"""The commands about the camera: what they print and write, and how they say that something is wrong."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from short_log import CORRIDOR, FRAMES, Localiser, cut_log
from small_log import write_edge_log, write_small_log

from localiser.storage import load_camera


@pytest.fixture
def localiser(capsys: pytest.CaptureFixture[str]) -> Localiser:
    return Localiser(capsys)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log whose camera file states a tilt that is 3° off, with comments."""
    folder = cut_log(CORRIDOR, tmp_path / "log", FRAMES)
    text = (folder / "camera.yaml").read_text()
    (folder / "camera.yaml").write_text(text.replace("tilt_deg: 20.0", "tilt_deg: 17.0") + "# measured by hand\n")
    return folder


@pytest.mark.parametrize("command", [["tilt"]])
def test_help_has_an_example(localiser: Localiser, command: list[str]) -> None:
    result = localiser("camera", *command, "--help")
    assert result.exit_code == 0
    assert f"localiser camera {command[0]}" in result.out.split("Example")[1]


# -- tilt -------------------------------------------------------------------------------------------------------------


def test_tilt_prints_what_is_stated_and_what_is_found(localiser: Localiser, log: Path) -> None:
    before = (log / "camera.yaml").read_bytes()
    result = localiser("camera", "tilt", log, "--images", 6)
    assert result.exit_code == 0
    rows = {line.split()[0]: line.split()[2:] for line in result.out.splitlines() if "°" in line}
    stated, found, sigma, difference = (float(text) for text in rows["tilt"])
    assert stated == 17.0 and abs(found - 20.0) < 0.1 and sigma < 0.05
    assert difference == pytest.approx(found - stated, abs=0.001)
    assert (log / "camera.yaml").read_bytes() == before


def test_written_tilt_is_read_back_and_the_old_file_is_kept(localiser: Localiser, log: Path) -> None:
    before = (log / "camera.yaml").read_text()
    result = localiser("camera", "tilt", log, "--write", "--images", 4)
    assert result.exit_code == 0 and "camera.yaml.bak" in result.out
    assert (log / "camera.yaml.bak").read_text() == before
    assert load_camera(log / "camera.yaml").mount.tilt_rad == pytest.approx(np.deg2rad(20.0), abs=np.deg2rad(0.1))
    after = (log / "camera.yaml").read_text()
    assert after.endswith("# measured by hand\n")
    old, new = yaml.safe_load(before), yaml.safe_load(after)
    changed = {key for key in old["mount"] if old["mount"][key] != new["mount"][key]}
    assert changed <= {"tilt_deg", "roll_deg"} and old | {"mount": 0} == new | {"mount": 0}
    again = localiser("camera", "tilt", log, "--write", "--images", 2, "--quiet")
    assert (again.exit_code, again.err) == (0, "")
    assert (log / "camera.yaml.bak").read_text() == before
    assert (log / "camera.yaml.bak2").read_text() == after


def test_plot_is_a_new_picture(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    plot = tmp_path / "pictures" / "tilt.png"
    assert localiser("camera", "tilt", log, "--plot", plot, "--images", 2).exit_code == 0
    picture = cv2.imread(str(plot))
    assert picture.shape[1] > 1000 and picture.std() > 10
    again = localiser("camera", "tilt", log, "--plot", plot, "--images", 2)
    assert again.exit_code == 2 and "expected a new file" in again.err


def test_images_without_edges_are_told_and_not_written(localiser: Localiser, tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log")  # noise only
    before = (log / "camera.yaml").read_bytes()
    result = localiser("camera", "tilt", log)
    assert result.exit_code == 0 and "hardly tell the tilt" in result.err
    result = localiser("camera", "tilt", log, "--write")
    assert result.exit_code == 2
    assert "not written" in result.err and str(log / "camera.yaml") in result.err
    assert (log / "camera.yaml").read_bytes() == before
    assert not list(log.glob("*.bak*"))


def test_a_log_of_measured_edges_has_no_lines_to_look_at(localiser: Localiser, tmp_path: Path) -> None:
    result = localiser("camera", "tilt", write_edge_log(tmp_path / "log"))
    assert result.exit_code == 2 and "expected a log with images" in result.err


def test_an_image_that_cannot_be_read_is_named(localiser: Localiser, log: Path) -> None:
    image = next((log / "images").iterdir())
    image.write_bytes(image.read_bytes()[:5000])
    result = localiser("camera", "tilt", log)
    assert result.exit_code == 2 and image.name in result.err and "Traceback" not in result.err
