"""What a replay warns of: bad light, and odometry that falls silent; each with its figures."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from short_log import CORRIDOR, FRAMES, Localiser, cut_log


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return cut_log(CORRIDOR, tmp_path / "log", FRAMES)


def figures_of(localiser: Localiser, log: Path, out: Path) -> dict:
    return json.loads((localiser.replay(log, out) / "metrics.json").read_text())


@pytest.mark.parametrize(("gain", "said"), [(0.2, "are dark: 95 %"), (3.0, "are washed out:")])
def test_bad_light_is_told(localiser: Localiser, log: Path, tmp_path: Path, gain: float, said: str) -> None:
    for path in (log / "images").iterdir():
        image = np.clip(gain * cv2.imread(str(path)), 0, 255).astype(np.uint8)
        cv2.imwrite(str(path), image)
    figures = figures_of(localiser, log, tmp_path / "out")
    (warning,) = [text for text in figures["warnings"] if said in text]
    assert warning.startswith("3 of 3 images looked at"), "every fifth"


def test_silent_odometry_is_told_and_a_plain_log_has_no_warning(
    localiser: Localiser, log: Path, tmp_path: Path
) -> None:
    plain = figures_of(localiser, log, tmp_path / "plain")
    assert plain["warnings"] == []
    header, *rows = (log / "odometry.csv").read_text().splitlines()
    kept = [row for row in rows if not 400_000_000 < int(row.split(",")[0]) < 1_900_000_000]
    (log / "odometry.csv").write_text("\n".join([header, *kept]) + "\n")
    silent = figures_of(localiser, log, tmp_path / "silent")
    (warning,) = silent["warnings"]
    assert "silent for more than 1 s 1×, for 1.5 s in all, in which 8 images came" in warning
    assert "after 0.4 s" in warning
