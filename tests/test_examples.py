"""Every script of examples/ runs, and localises well."""

import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import pytest
from short_log import CORRIDOR, cut_log

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def output(name: str, *arguments: object) -> str:
    """Return what an example prints."""
    command = [sys.executable, ROOT / "examples" / f"{name}.py", *arguments]
    environment = os.environ | {"MPLBACKEND": "Agg"}
    run = subprocess.run(map(str, command), cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout


def figures(text: str) -> list[float]:
    """Return the numbers with a decimal point in a text."""
    return [float(number) for number in re.findall(r"\d+\.\d+", text)]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return cut_log(CORRIDOR, tmp_path_factory.mktemp("log") / "corridor", 20)


def test_every_example_is_tested() -> None:
    tested = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert {example.stem for example in EXAMPLES} <= tested


@pytest.mark.slow
def test_replay_and_plot(log: Path, tmp_path: Path) -> None:
    text = output("replay_and_plot", log, "--out", tmp_path / "path.png")
    assert "position_rmse_m" in text and max(figures(text)) < 0.5
    picture = cv2.imread(str(tmp_path / "path.png"))
    assert picture is not None and picture.std() > 1


@pytest.mark.slow  # quick: the other examples; this one takes 4 s
def test_own_bearings() -> None:
    last, worst, wheels = figures(output("own_bearings"))
    assert last < 0.03 and worst < 0.28 and wheels > 0.15


@pytest.mark.slow
def test_own_detector(log: Path) -> None:
    edges, error_m = figures(output("own_detector", log))
    assert edges > 10 and error_m < 0.1


def test_tags() -> None:
    """The error stays below that of one measured range."""
    last, worst, wheels = figures(output("tags"))
    assert last < 0.03 and worst < 0.15 and wheels > 0.15
    assert len((ROOT / "examples" / "tags.py").read_text(encoding="utf-8").splitlines()) <= 150


@pytest.mark.slow
def test_hundred_seeds(log: Path) -> None:
    text = output("hundred_seeds", log, "--seeds", 3)
    median, low, high = figures(text)
    assert text.startswith("3 seeds") and 0 < low <= median <= high < 0.1
