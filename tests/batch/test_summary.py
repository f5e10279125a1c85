"""The tables of a batch."""

from __future__ import annotations

from pathlib import Path

from batches import row
from rich.console import Console
from rich.table import Table

from localiser.batch import compare_with, comparison_table, failures, summary_table


def lines(table: Table, width: int = 80) -> list[str]:
    console = Console(width=width, color_system=None)
    with console.capture() as capture:
        console.print(table)
    return [" ".join(line.split()) for line in capture.get().splitlines() if line.strip()]


def test_a_row_has_the_median_and_the_worst_over_seeds() -> None:
    kinds = {"line": (0.1, 0.3, 0.2), "slope": (0.4, 0.4, 0.4)}
    rows = [
        row("a", seed, rmse, **{"set.observation.kind": kind, "set.mcl.particles": "9", "confidence.sure": 1 - rmse})
        for kind, errors in kinds.items()
        for seed, rmse in enumerate(errors)
    ]
    found = lines(summary_table(rows))
    assert found[1] == "mcl.particles 9"
    assert found[-2:] == ["a line 3 0.200 (0.300) 80 (70)", "a slope 3 0.400 60"]


def test_failed_runs_are_counted_and_left_out_of_the_figures() -> None:
    rows = [row("a", 0, 0.1), row("a", 1, None)]
    assert lines(summary_table(rows))[-1] == "a 2, 1 failed 0.100"
    assert failures(rows) == ["a (seed 1): no such log"]


def test_comparisons_say_what_changed_by_how_much() -> None:
    here = [
        row(log, seed, rmse * (1 + seed / 100), **{"confidence.sure": 0.5})
        for log, rmse in (("a", 0.1), ("b", 0.2), ("c", 0.1))
        for seed in range(3)
    ]
    there = [row(log, seed, 0.1, **{"confidence.sure": 0.5}) for log in ("a", "b", "c") for seed in range(3)]
    found = lines(comparison_table(compare_with(here, there, Path("there"))), 120)
    told = [line for line in found if line.startswith(("position", "images"))]
    assert told[0].startswith("position RMSE all logs 3 +27.2 % ") and not told[0].endswith("worse")
    assert told[1].startswith("position RMSE b 3 +102.0 % ") and told[1].endswith("worse")
    assert told[2] == "images sure all logs 3 +0.0 points +0.0 … +0.0 points"
