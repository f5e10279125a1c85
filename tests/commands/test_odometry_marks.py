"""`localiser odometry marks`: the truth of the log that ships, from some marks of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from folders import ROOT
from typer.testing import CliRunner

from localiser.commands.main import app
from localiser.errors import InputError
from localiser.storage import open_log, read_poses

LOG = ROOT / "logs" / "corridor"


def marks(path: Path, wrong_m: float = 0.0) -> Path:
    log = open_log(LOG)
    first = int(log.odometry.t_ns[0])
    rows = []
    for t_s in range(1, 41, 3):
        x, z, _ = log.groundtruth.at(first + t_s * 1_000_000_000)
        rows.append(f"{t_s},{x + (wrong_m if t_s == 16 else 0):.4f},{z:.4f}\n")
    path.write_text("t_s,x,z\n" + "".join(rows))
    return path


def test_poses_are_written_and_near_the_truth(tmp_path: Path) -> None:
    out = tmp_path / "groundtruth.csv"
    command = ["odometry", "marks", str(LOG), str(marks(tmp_path / "marks.csv")), "-o", str(out)]
    told = CliRunner().invoke(app, command)
    assert told.exit_code == 0, told.output
    assert "over 14 marks" in told.output
    found, truth = read_poses(out), open_log(LOG).groundtruth
    off = found.poses - truth.sampled(found.t_ns).poses
    assert np.sqrt(np.mean(off[:, 0] ** 2 + off[:, 1] ** 2)) < 0.05


def test_a_wrong_mark_is_named_by_its_line(tmp_path: Path) -> None:
    command = ["odometry", "marks", str(LOG), str(marks(tmp_path / "m.csv", 1.0)), "-o", str(tmp_path / "out.csv")]
    told = CliRunner().invoke(app, command)
    assert isinstance(told.exception, InputError)
    assert "m.csv:7: expected a mark within 5 sigma" in str(told.exception)
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize("text", ["t_s,x,z\n1,0,0\n99,1,1\n"])
def test_a_time_that_the_log_does_not_have_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "m.csv").write_text(text)
    command = ["odometry", "marks", str(LOG), str(tmp_path / "m.csv"), "-o", str(tmp_path / "out.csv")]
    told = CliRunner().invoke(app, command)
    assert "m.csv:3: t_s: expected a time of the odometry" in str(told.exception)
