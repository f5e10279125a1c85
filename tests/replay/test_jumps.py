"""Logs whose clock or wheels jump: work goes by what was measured, never by how far apart it is."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from short_log import CORRIDOR, Localiser, cut_log

DECADES_NS = 30 * 365 * 86_400 * 10**9
JUMP_NS = 1_000_000_000
TABLES = ("images.csv", "odometry.csv", "groundtruth.csv")


def jumped_log(folder: Path, column: str, jump: float) -> Path:
    """Return a log in which a column of all tables that have it is greater by `jump` after some images."""
    log = cut_log(CORRIDOR, folder, 12)
    for name in TABLES:
        with (log / name).open(newline="") as file:
            rows = list(csv.DictReader(file))
        if column in rows[0]:
            for row in rows:
                if int(row["t_ns"]) > JUMP_NS:
                    row[column] = str(type(jump)(row[column]) + jump)
            lines = [",".join(rows[0]), *(",".join(row.values()) for row in rows)]
            (log / name).write_text("\n".join(lines) + "\n")
    return log


@pytest.mark.parametrize("odometry", [pytest.param("wheel", marks=pytest.mark.slow), "vision"])
def test_a_calendar_that_jumps_by_decades_takes_no_longer(localiser: Localiser, tmp_path: Path, odometry: str) -> None:
    log = jumped_log(tmp_path / "log", "t_ns", DECADES_NS)
    run = localiser.replay(log, tmp_path / "out", "--odometry", odometry)
    assert json.loads((run / "metrics.json").read_text())["frames"] == 12


def test_wheels_that_jump_around_the_world_are_survived(localiser: Localiser, tmp_path: Path) -> None:
    log = jumped_log(tmp_path / "log", "x", 9e8)
    run = localiser.replay(log, tmp_path / "out", "--start", "0.11,0.60,1.2")
    assert json.loads((run / "metrics.json").read_text())["frames"] == 12
