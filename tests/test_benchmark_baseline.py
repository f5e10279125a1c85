"""How benchmarks/baseline.py compares: tolerances from the spread of seeds, verdicts, the file. Nothing is measured."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from folders import ROOT

BENCHMARKS = ROOT / "benchmarks"
KEY = ("efficiency", "line known 300", "rmse / bound")


@pytest.fixture(scope="module")
def benchmark() -> Iterator[Any]:
    """Return the script, which is not a part of the package."""
    sys.path.insert(0, str(BENCHMARKS))
    import baseline

    yield baseline
    sys.path.remove(str(BENCHMARKS))


@pytest.fixture(scope="module")
def compare(benchmark: Any) -> Any:
    from figures import compare

    return compare


@pytest.fixture(scope="module")
def measures(benchmark: Any) -> Any:
    from figures import measures

    return measures


# -- tolerance --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("over", ["median", "mean"])
def test_what_is_the_same_with_every_seed_has_no_tolerance(measures: Any, over: str) -> None:
    assert measures.tolerance(measures.Measure("up", over), [0.0] * 20, 5) == 0.0
    assert measures.tolerance(measures.Measure("up", over), [0.7], 1) == 0.0


def test_tolerance_of_a_mean_is_z_standard_errors_of_a_difference(measures: Any) -> None:
    samples = np.random.default_rng(1).normal(3.0, 0.2, 20)
    expected = 3.09 * np.sqrt(2) * samples.std(ddof=1) / np.sqrt(5)
    assert measures.tolerance(measures.Measure("up", "mean"), samples, 5) == pytest.approx(expected, rel=0.05)
    smaller = measures.tolerance(measures.Measure("up", "mean"), samples, 20)
    assert smaller == pytest.approx(expected / 2, rel=0.05), "four times the seeds, half the tolerance"


@pytest.mark.parametrize("over", ["median", "mean"])
def test_other_random_numbers_are_hardly_ever_a_loss_and_worse_code_is(compare: Any, measures: Any, over: str) -> None:
    """Baselines of code with errors 1 ± 0.1; five other seeds of the same code, and of code that is 40 % worse."""
    rng = np.random.default_rng(0)
    lost = {1.0: 0, 1.4: 0}
    trials = 300
    for _ in range(trials):
        samples = rng.normal(1.0, 0.1, 20)
        measure = measures.Measure("up", over)
        figure = compare.Figure(measure.of(samples[:5]), "up", measures.tolerance(measure, samples, 5), over)
        for scale in lost:
            now = measure.of(scale * rng.normal(1.0, 0.1, 5))
            lost[scale] += compare.verdict_of(figure, now) == "LOSS"
    assert lost[1.0] <= 0.01 * trials
    assert lost[1.4] >= 0.9 * trials


# -- verdicts ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("loss", "before", "now", "verdict"),
    [
        ("up", 1.0, 1.0, "same"),
        ("up", 1.0, 1.09, "moved"),
        ("up", 1.0, 1.11, "LOSS"),
        ("up", 1.0, 0.89, "better"),
        ("down", 1.0, 0.89, "LOSS"),
        ("down", 1.0, 1.11, "better"),
        ("from one", 1.0, 1.08, "moved"),
        ("from one", 1.0, 1.2, "LOSS"),
        ("from one", 1.0, 1 / 1.2, "LOSS"),
        ("from one", 2.0, 1.5, "better"),
        ("from one", 2.0, 0.5, "moved"),  # twice and half are as far from one
        ("up", 1.0, float("nan"), "LOSS"),
    ],
)
def test_a_figure_is_lost_past_its_tolerance_in_its_own_direction(
    compare: Any, loss: str, before: float, now: float, verdict: str
) -> None:
    assert compare.verdict_of(compare.Figure(before, loss, 0.1), now) == verdict


def test_without_tolerance_whatever_gets_worse_is_a_loss(compare: Any) -> None:
    never_wrong = compare.Figure(0.0, "up", 0.0, "mean", [0.0] * 20)
    assert compare.verdict_of(never_wrong, 1e-6) == "LOSS"
    recall = compare.Figure(0.98, "down")
    assert [compare.verdict_of(recall, now) for now in (0.9799, 0.98, 0.9801)] == ["LOSS", "same", "better"]


def test_other_bytes_are_a_loss_where_bytes_can_be_equal(compare: Any) -> None:
    (one,) = compare.compared({KEY: compare.Figure("ab", "change")}, {KEY: "cd"}, {}, {})
    assert one.verdict == "LOSS"
    assert compare.elsewhere(one).verdict == "other machine"


def test_nothing_that_was_not_measured_passes_silently(compare: Any) -> None:
    from figures.show import summary_of

    figure = compare.Figure(1.0, "up")
    keys = {name: ("efficiency", name, "rmse / bound") for name in ("gone", "skipped", "failed", "new", "same")}
    baseline = {key: figure for name, key in keys.items() if name != "new"}
    now = {keys["new"]: 2.0, keys["same"]: 1.0}
    found = compare.compared(baseline, now, {keys["skipped"]: "no data"}, {keys["failed"]: "no such option"})
    verdicts = {one.key[1]: one for one in found}
    assert {name: one.verdict for name, one in verdicts.items()} == {
        "gone": "gone",
        "skipped": "skipped",
        "failed": "LOSS",
        "new": "new",
        "same": "same",
    }
    assert verdicts["skipped"].reason == "no data" and verdicts["failed"].reason == "no such option"
    assert compare.elsewhere(verdicts["failed"]).verdict == "LOSS", "a failure is one on any machine"
    summary = summary_of(found)
    assert "2 figures are worse; 1 figures were not looked at" in summary
    assert "1 same, 1 new, 1 skipped, 1 gone, 1 LOSS" in summary


# -- the file and the tasks -------------------------------------------------------------------------------------------


def test_the_committed_figures_follow_from_their_samples(benchmark: Any) -> None:
    figures, about = benchmark.store.read(benchmark.FILE)
    assert set(about) == set(benchmark.GROUPS)
    for key, figure in figures.items():
        group = benchmark.GROUPS[key[0]]
        said = about[key[0]]
        assert said["check_seeds"] == group.checked(said["seeds"])
        if not isinstance(figure.value, str):
            assert len(figure.samples) == said["seeds"]
            assert group.figure(key[2], figure.samples) == figure, key


def test_a_check_takes_no_seed_that_the_baseline_does_not_have(
    benchmark: Any, compare: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "file.json"
    benchmark.store.write(file, {}, {"efficiency": {"seeds": 8, "machine": {}}})
    monkeypatch.setattr(benchmark, "FILE", file)
    asked: list[Any] = []
    monkeypatch.setattr(benchmark, "measure", lambda tasks, jobs: (asked.extend(tasks), ({}, {}))[1])
    group = benchmark.GROUPS["efficiency"]
    benchmark.check({"efficiency": group}, tmp_path, 1)
    assert group.check_seeds > 8
    assert {task.seed for task in asked} == set(range(8))


def test_every_task_is_in_the_committed_file(benchmark: Any, tmp_path: Path) -> None:
    figures, _ = benchmark.store.read(benchmark.FILE)
    tasks = {(task.group, task.case) for group in benchmark.GROUPS.values() for task in group.tasks(tmp_path, 1)}
    assert tasks == {key[:2] for key in figures}


def test_a_check_leaves_out_what_is_measured_by_hand(benchmark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["baseline.py", "--check"])
    assert set(benchmark.GROUPS) - set(benchmark.arguments().only) == {"instructions"}


def test_instructions_may_differ_by_a_hundredth(benchmark: Any, compare: Any) -> None:
    figure = benchmark.GROUPS["instructions"].figure("whole, millions", [200.0, 200.01])
    assert [compare.verdict_of(figure, now) for now in (201.9, 202.1)] == ["moved", "LOSS"]


def test_instructions_of_an_image_are_the_difference_of_two_replays(
    benchmark: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    import instructions

    def replayed(around: list[str], configuration: str, seed: int, images: int, what: str) -> str:
        count = 21_345_049_204 + images * {"edges": 8_000_000, "whole": 45_000_000}[what]
        return f"==6053== \n==6053== I   refs:      {count:,}\n"

    monkeypatch.setattr(instructions, "replayed", replayed)
    assert instructions.millions("small") == {"edges": 8.0, "whole": 45.0}


def test_a_file_that_is_written_is_read_the_same(benchmark: Any, compare: Any, tmp_path: Path) -> None:
    figures = {
        KEY: compare.Figure(0.5, "up", 0.1, "mean", [0.4, 0.6]),
        ("hashes", "map", "map"): compare.Figure("ab", "change"),
    }
    about = {"efficiency": {"seeds": 2}, "hashes": {"seeds": 1}}
    benchmark.store.write(tmp_path / "file.json", figures, about)
    assert benchmark.store.read(tmp_path / "file.json") == (figures, about)


def test_values_are_joined_in_the_order_of_seeds(benchmark: Any) -> None:
    from figures.tasks import Task

    tasks = [Task("efficiency", "line known 300", seed, dict) for seed in (2, 0, 1)]
    samples = benchmark.samples_of([(task, {"rmse / bound": task.seed + 1 / 3}) for task in tasks])
    assert samples == {KEY: [0.333333, 1.33333, 2.33333]}


def _broken() -> dict[str, float]:
    raise AssertionError("measured again")


def test_an_interrupted_measurement_keeps_what_it_has(benchmark: Any, tmp_path: Path) -> None:
    from figures.tasks import Task, keep, measured

    kept = tmp_path / "kept.jsonl"
    kept.write_text('["efficiency/line known 300/0", {"rmse / bound": 0.5}]\n["efficiency/line known 300/1", {"posit')
    task, cut_off = (Task("efficiency", "line known 300", seed, partial(_broken)) for seed in (0, 1))
    assert list(measured([task], 1, kept)) == [(task, {"rmse / bound": 0.5})]
    keep(kept, cut_off, {"rmse / bound": 0.25})
    assert list(measured([task, cut_off], 1, kept)) == [
        (task, {"rmse / bound": 0.5}),
        (cut_off, {"rmse / bound": 0.25}),
    ]


def test_a_check_ends_with_1_when_something_is_worse(
    benchmark: Any, compare: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = {("efficiency", "line known 300", "ess"): compare.Figure(200.0, "down", 20.0)}
    file = tmp_path / "file.json"
    benchmark.store.write(file, figures, {"efficiency": {"machine": {}}})
    monkeypatch.setattr(benchmark, "FILE", file)
    monkeypatch.setattr(sys, "argv", ["baseline.py", "--check", "--only", "efficiency"])
    codes = []
    for now in (200.0, 190.0, 150.0):
        samples = dict.fromkeys(figures, [now] * 10)
        monkeypatch.setattr(benchmark, "measure", lambda tasks, jobs, samples=samples: (samples, {}))
        codes.append(benchmark.main())
    assert codes == [0, 0, 1]
    out = capsys.readouterr().out
    assert "nothing is worse" in out and "1 figures are worse" in out
