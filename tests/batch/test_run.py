"""The batch: rows, what is not done again, failures, exit codes, workers; what it runs, and what runs are called."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from short_log import CORRIDOR, FEW_PARTICLES, Localiser, Result, cut_log
from small_log import write_edge_log, write_small_log

from localiser.batch import choices_of, run, seeds_of
from localiser.batch.choices import Opening, contents_of, map_id, run_id, values_of
from localiser.config import Config, read_config
from localiser.errors import InputError, RunEndedEarlyError
from localiser.storage import csv_text, read_figures, read_map, read_runs

IMAGES = 4


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return cut_log(CORRIDOR, tmp_path / "drive", IMAGES)


@pytest.fixture
def began(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list that gets the seed of every run that is begun."""
    seeds: list[int] = []
    real = run.replay_task

    def counted(task: Any) -> Any:
        seeds.append(task.config.seed)
        return real(task)

    monkeypatch.setattr(run, "replay_task", counted)
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
    more = batch(localiser, out, elsewhere, "--seeds", "1-2")
    assert more.exit_code == 0 and "done already: 1; left: 1." in more.err
    assert began == [0, 1, 2]


def test_a_failed_run_is_a_row_with_its_reason_and_is_tried_again(localiser, log, tmp_path, began):
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


def test_a_run_that_is_kept_as_ctrl_c_comes_is_in_the_table(localiser, log, tmp_path, monkeypatch):
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
    monkeypatch.setattr(run.FolderRun, "run", Mock(side_effect=RunEndedEarlyError("stopped", 130)))
    result = batch(localiser, tmp_path / "during", log, "--seeds", "0-1")
    assert result.exit_code == 130 and "stopped after 0 of 2 runs" in result.err


def test_every_combination_comes_once_and_seeds_vary_fastest(tmp_path: Path) -> None:
    files = [tmp_path / "a.yaml", tmp_path / "b.yaml"]
    for file in files:
        file.write_text("mcl: {particles: 100}\n")
    overrides = ["observation.kind=line,slope,line", "mcl.particles=500"]
    found = choices_of([*files, files[0]], overrides, "3,0-1,1")
    assert [(one.config, dict(one.settings)["observation.kind"], one.seed) for one in found] == [
        (file, kind, seed) for file in files for kind in ("line", "slope") for seed in (3, 0, 1)
    ]
    config = found[4].config_for()
    assert (config.observation.kind, config.mcl.particles, config.seed) == ("slope", 500, 0)


def test_a_list_is_one_value() -> None:
    overrides = ["edges.mask=[0, 1],[2,3]", 'a="b,c",d', "e={f: 1, g: 2},3"]
    assert [values_of(text)[1] for text in overrides] == [["[0, 1]", "[2,3]"], ['"b,c"', "d"], ["{f: 1, g: 2}", "3"]]


@pytest.mark.parametrize("text", ["", "4-0", "0-", "-1", "0,,1", "0-4294967296", "0-99999999"])
def test_what_are_no_seeds_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--seeds: expected seeds such as 0-4"):
        seeds_of(text)


@pytest.mark.parametrize(
    ("overrides", "seeds", "said"),
    [
        (["mcl.particles"], None, "expected section.name=value"),
        (["mcl.particles=100,,200"], None, "expected section.name=value"),
        (["mcl.particles=100", "mcl.particles=200"], None, "expected each name once"),
        (["seed=1,2"], "0-4", "by --set or by --seeds"),
        (["mcl.particles=100,none"], None, "mcl.particles"),
        (["mcl.particels=100"], None, "particels"),
    ],
)
def test_bad_options_are_refused_before_anything_runs(overrides: list[str], seeds: str | None, said: str) -> None:
    with pytest.raises(InputError, match=said):
        choices_of([], overrides, seeds)


def name_of(log: Path, config: Config | None = None, start: str | None = None) -> str:
    return run_id(contents_of(log, Opening()), config or Config(), start, "")


def change(file: Path, before: str, after: str) -> None:
    text = file.read_text()
    assert before in text
    file.write_text(text.replace(before, after, 1))


@pytest.mark.parametrize("write", [write_small_log, write_edge_log])
def test_a_copy_elsewhere_is_the_same(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    log = write(tmp_path / "log")
    assert name_of(log) == name_of(shutil.copytree(log, tmp_path / "copy"))


@pytest.mark.parametrize(
    ("file", "before", "after"),
    [
        ("images.csv", "100000000", "110000000"),
        ("odometry.csv", "-0.4", "-0.5"),
        ("map.yaml", "-1.25", "-1.5"),
        ("camera.yaml", "0.8", "0.9"),
        ("groundtruth.csv", "1.6", "1.7"),
        ("log.yaml", "170", "171"),
    ],
)
def test_whatever_is_in_a_log_counts(tmp_path: Path, file: str, before: str, after: str) -> None:
    log = write_small_log(tmp_path / "log")
    was = name_of(log)
    change(log / file, before, after)
    assert name_of(log) != was


def test_the_pixels_of_every_image_count(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log")
    was = contents_of(log, Opening())
    first, *_, last = sorted((log / "images").iterdir())
    shutil.copy(first, last)
    found = contents_of(log, Opening())
    assert found.log_id != was.log_id and found.rest_id == was.rest_id


def test_settings_start_map_and_version_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = write_small_log(tmp_path / "log")
    found = contents_of(log, Opening())
    names = {
        name_of(log),
        name_of(log, read_config(overrides=["motion.alpha1=0.3"])),
        name_of(log, Config(seed=1)),
        name_of(log, start="truth"),
        run_id(found, Config(), None, map_id(read_map(log / "map.yaml"))),
    }
    monkeypatch.setattr("localiser.batch.choices.__version__", "another")
    names.add(name_of(log))
    assert len(names) == 6


def test_a_log_that_cannot_be_read_says_why(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log")
    (log / "odometry.csv").unlink()
    assert "odometry.csv: no such file" in str(contents_of(log, Opening()).error)


def test_a_corrected_map_or_camera_leaves_the_measurements_the_same(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log")
    was = contents_of(log, Opening())
    change(log / "map.yaml", "-1.25", "-1.5")
    found = contents_of(log, Opening())
    assert found.log_id == was.log_id and found.rest_id != was.rest_id
