"""`odometry fit`: what it prints and writes, and how it says that something is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from short_log import CORRIDOR, FEW_PARTICLES, Localiser, cut_log
from small_log import write_small_log

from localiser.config import read_config
from localiser.motion import MotionParameters


def test_fit_tells_what_it_would_change_and_writes_a_configuration(localiser: Localiser, tmp_path: Path) -> None:
    out = tmp_path / "robot.yaml"
    result = localiser("odometry", "fit", CORRIDOR, "-o", out)
    assert result.exit_code == 0, result.err
    row = next(line.split() for line in result.out.splitlines() if "alpha2" in line)
    found, before = read_config(out).motion, MotionParameters()
    assert float(row[1]) == before.alpha2 and float(row[2]) == pytest.approx(found.alpha2, rel=0.01)
    assert found.alpha2 < before.alpha2, "these wheels are better than most"
    assert found.bias.delay_sigma_s == before.bias.delay_sigma_s
    assert "corridor (truth)" in out.read_text()
    again = localiser("odometry", "fit", CORRIDOR, "-o", out)
    assert again.exit_code == 2 and "expected a new file" in again.err and "alpha2" not in again.out


@pytest.mark.parametrize(("images", "within"), [(120, 0.25), (205, 0.1)])
@pytest.mark.slow  # quick: tests/calibration/test_odometry.py fits the filter's path of simulated wheels
def test_without_a_truth_the_filter_s_path_tells_nearly_the_same(
    localiser: Localiser, tmp_path: Path, images: int, within: float
) -> None:
    log, paths = cut_log(CORRIDOR, tmp_path / "log", images), {}
    for name in ("truth", "filter"):
        paths[name] = tmp_path / f"{name}.yaml"
        assert localiser("odometry", "fit", log, "-q", "-o", paths[name], *FEW_PARTICLES).exit_code == 0
        description = (log / "log.yaml").read_text()
        (log / "log.yaml").write_text(description.replace("groundtruth: groundtruth.csv\n", ""))
    true, found = (read_config(path).motion for path in paths.values())
    assert found.bias.distance_sigma == pytest.approx(true.bias.distance_sigma, rel=within)
    assert found.bias.turn_sigma == pytest.approx(true.bias.turn_sigma, rel=within)
    for name in ("alpha2", "alpha3"):
        assert 1 / 3 < getattr(found, name) / getattr(true, name) < 3


def test_a_log_that_is_too_short_is_told(localiser: Localiser, tmp_path: Path) -> None:
    result = localiser("odometry", "fit", write_small_log(tmp_path / "log"))
    assert result.exit_code == 2 and "ten metres" in result.err and "Traceback" not in result.err
