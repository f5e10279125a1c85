"""The batch as a whole, by the command: rows, what is not done again, failures, exit codes, workers."""

from __future__ import annotations

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from short_log import CORRIDOR, FEW_PARTICLES, Localiser, Result, cut_log

from localiser.batch import run
from localiser.storage import csv_text, read_figures, read_runs

IMAGES = 4


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return cut_log(CORRIDOR, tmp_path / "drive", IMAGES)


@pytest.fixture
def began(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list that gets the seed of every run that is begun."""
    seeds: list[int] = []
    real = run.replayed

    def counted(task: Any) -> Any:
        seeds.append(task.config.seed)
        return real(task)

    monkeypatch.setattr(run, "replayed", counted)
    return seeds


def batch(localiser: Localiser, out: Path, *arguments: object) -> Result:
    return localiser("batch", *arguments, "-o", out, "--jobs", "1", *FEW_PARTICLES)


def rows(out: Path) -> list[dict[str, str]]:
    """Return the rows without the columns that differ from run to run."""
    with (out / "runs.csv").open(newline="") as file:
        return [{name: cell for name, cell in row.items() if "_ms" not in name} for row in csv.DictReader(file)]


def test_a_batch_has_the_figures_of_single_replays(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    result = batch(localiser, tmp_path / "out", log, "--seeds", "0-1", "--set", "observation.kind=line,slope")
    assert result.exit_code == 0 and "corridor" in result.out
    found = rows(tmp_path / "out")
    assert [(row["set.observation.kind"], row["seed"]) for row in found] == [
        ("line", "0"), ("line", "1"), ("slope", "0"), ("slope", "1"),
    ]  # fmt: skip
    single = localiser.replay(log, tmp_path / "single", "--seed", 1, "--observation", "slope")
    folder = tmp_path / "out" / found[3]["folder"]
    for name in ("trajectory.csv", "trajectory.tum", "config.yaml"):
        assert (folder / name).read_bytes() == (single / name).read_bytes()
    assert found[3]["position_rmse_m"] != found[2]["position_rmse_m"]


def test_what_is_done_is_not_done_again(localiser: Localiser, log: Path, tmp_path: Path, began: list[int]) -> None:
    out = tmp_path / "out"
    assert batch(localiser, out, log, "--seeds", "0-1").exit_code == 0
    first = (out / "runs.csv").read_bytes()
    assert batch(localiser, out, log, "--seeds", "0-1").exit_code == 0
    assert began == [0, 1] and (out / "runs.csv").read_bytes() == first
    elsewhere = shutil.copytree(log, tmp_path / "elsewhere")
    assert batch(localiser, out, elsewhere, "--seeds", "1-2").exit_code == 0
    assert began == [0, 1, 2]


def test_a_failed_run_is_a_row_with_its_reason_and_is_tried_again(
    localiser: Localiser, log: Path, tmp_path: Path, began: list[int]
) -> None:
    without_map = cut_log(CORRIDOR, tmp_path / "without", IMAGES)
    text = (without_map / "log.yaml").read_text()
    (without_map / "log.yaml").write_text("".join(line for line in text.splitlines(True) if "map" not in line))
    result = batch(localiser, tmp_path / "out", tmp_path / "none", without_map, log)
    assert result.exit_code == 2 and result.err.count("Failed: ") == 2
    missing, failed, done = rows(tmp_path / "out")
    assert missing["error"].endswith("none: no such log") and "the log has no map" in failed["error"]
    assert done["error"] == "" and float(done["position_rmse_m"]) < 0.1
    assert (failed["position_rmse_m"], failed["log"]) == ("", "corridor")
    batch(localiser, tmp_path / "out", tmp_path / "none", without_map, log)
    assert len(began) == 3


def test_a_comparison_ends_with_1_on_a_loss(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    out, half, double = tmp_path / "out", tmp_path / "half.csv", tmp_path / "double.csv"
    same = batch(localiser, out, log, "--seeds", "0-1")
    assert same.exit_code == 0
    found = read_runs(out / "runs.csv")
    half.write_text(csv_text([row | {"position_rmse_m": row["position_rmse_m"] / 2} for row in found]))
    double.write_text(csv_text([row | {"position_rmse_m": row["position_rmse_m"] * 2} for row in found]))
    same = batch(localiser, out, log, "--seeds", "0-1", "--against", out)
    assert same.exit_code == 0 and "2 pairs: no significant loss." in same.out
    worse = batch(localiser, out, log, "--seeds", "0-1", "--against", half)
    assert worse.exit_code == 1 and "2 pairs: a significant loss." in worse.out and "+100.0 %" in worse.out
    better = batch(localiser, out, log, "--seeds", "0-1", "--against", double)
    assert better.exit_code == 0 and "better" in better.out
    assert batch(localiser, out, log, "--against", tmp_path / "none").exit_code == 2


def command(log: Path, out: Path, *arguments: str) -> list[str]:
    return [sys.executable, "-m", "localiser", "batch", str(log), "-o", str(out), *arguments]


@pytest.mark.slow
def test_an_interrupted_batch_goes_on_from_there(localiser: Localiser, tmp_path: Path) -> None:
    log, out, whole = cut_log(CORRIDOR, tmp_path / "drive", 20), tmp_path / "out", tmp_path / "whole"
    options = ("--seeds", "0-3", "--jobs", "2", *FEW_PARTICLES)
    process = subprocess.Popen(command(log, out, *options), stderr=subprocess.PIPE, text=True, start_new_session=True)
    while process.poll() is None and len(list(out.glob("runs/*/*/row.json"))) < 1:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does: workers get it too
    _, told = process.communicate(timeout=60)
    done = {path: path.stat().st_mtime_ns for path in out.glob("runs/*/*/row.json")}
    assert process.returncode == 130 and "the same command goes on from there" in told and 1 <= len(done) < 4
    assert "Traceback" not in told
    assert len(rows(out)) == len(done)
    assert subprocess.run(command(log, out, *options), check=False, capture_output=True).returncode == 0
    assert all(path.stat().st_mtime_ns == written for path, written in done.items())
    assert batch(localiser, whole, log, "--seeds", "0-3").exit_code == 0
    assert rows(out) == rows(whole)


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_rows(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        address = ("--cluster", cluster.scheduler_address)
        result = localiser("batch", log, "--seeds", "0-3", "-o", tmp_path / "dask", *FEW_PARTICLES, *address)
    assert result.exit_code == 0, result.err
    assert batch(localiser, tmp_path / "here", log, "--seeds", "0-3").exit_code == 0
    assert rows(tmp_path / "dask") == rows(tmp_path / "here")


def test_a_cluster_that_cannot_be_reached_is_told(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    result = batch(localiser, tmp_path / "out", log, "--cluster", "nonsense://nowhere")
    assert result.exit_code == 2 and "no Dask scheduler can be reached at nonsense://nowhere" in result.err


def test_the_same_run_twice_is_refused(localiser: Localiser, log: Path, tmp_path: Path) -> None:
    copied = shutil.copytree(log, tmp_path / "copied")
    result = batch(localiser, tmp_path / "out", log, copied)
    assert result.exit_code == 2 and "the same content and settings twice" in result.err and "copied" in result.err
    assert batch(localiser, tmp_path / "out", log, log).exit_code == 0


def test_a_run_that_is_kept_as_ctrl_c_comes_is_in_the_table(
    localiser: Localiser, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Path] = []

    def stopped_at_first(path: Path) -> dict[str, Any]:
        asked.append(path)
        if len(asked) == 1:
            raise KeyboardInterrupt
        return read_figures(path)

    monkeypatch.setattr("localiser.batch.run.read_figures", stopped_at_first)
    result = batch(localiser, tmp_path / "out", log, "--seeds", "0-1")
    assert result.exit_code == 130 and "stopped after 1 of 2 runs" in result.err
    assert len(rows(tmp_path / "out")) == 1
