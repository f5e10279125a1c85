"""Comparisons in pairs: intervals against scipy, Holm's correction, which runs are pairs; the tables of a batch."""

from pathlib import Path

import numpy as np
import pytest
from batches import row
from rich.console import Console
from rich.table import Table
from scipy import stats

from localiser.batch import compare_with, comparison_table, failures, summary_table
from localiser.batch.compare import ALL_LOGS, COMPARED, Comparison, compare_pairs, holm
from localiser.errors import InputError

RMSE = COMPARED[:1]


def pairs_of(ratios: dict[str, list[float]]) -> list[tuple[dict[str, object], dict[str, object]]]:
    """Runs there have an error of 0.1 m, runs here that times the ratio."""
    return [
        (row(log, seed, 0.1 * ratio), row(log, seed, 0.1))
        for log, of in ratios.items()
        for seed, ratio in enumerate(of)
    ]


def by_log(comparisons: list[Comparison]) -> dict[str, Comparison]:
    return {one.log: one for one in comparisons}


def test_holm_adjusts_as_by_hand() -> None:
    adjusted, level = holm(np.array([0.01, 0.04, 0.03, 0.005]))
    # Sorted: 0.005 · 4, 0.01 · 3, 0.03 · 2 (the first above 0.05), 0.04 · 1, which may not be less than the one before.
    np.testing.assert_allclose(adjusted, [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(level, [0.05 / 3, 0.05 / 2, 0.05 / 2, 0.05 / 4])


def test_an_interval_leaves_out_nothing_just_where_holm_finds_a_difference() -> None:
    rng = np.random.default_rng(0)
    ratios = {f"log {n}": list(np.exp(rng.normal(0.02 * (n % 5), 0.03, 4))) for n in range(20)}
    found = compare_pairs(pairs_of(ratios), RMSE)
    differs = [one.p <= 0.05 for one in found]
    assert differs == [one.low > 0 or one.high < 0 for one in found]
    assert any(differs) and not all(differs)


def test_one_comparison_is_the_t_test_of_the_log_ratios() -> None:
    ratios = [1.1, 1.3, 0.9, 1.25, 1.2]
    (found,) = compare_pairs(pairs_of({"house": ratios}), RMSE)
    oracle = stats.ttest_1samp(np.log(ratios), 0.0)
    interval = oracle.confidence_interval(0.95)
    assert found.pairs == 5
    np.testing.assert_allclose([found.loss, found.p], [np.log(ratios).mean(), oracle.pvalue])
    np.testing.assert_allclose([found.low, found.high], [interval.low, interval.high])


def test_logs_are_the_units_of_all_logs_together() -> None:
    """A thousand seeds of two logs say no more of other logs than two logs do."""
    ratios = {"a": [1.5] * 500 + [1.51] * 500, "b": [0.9] * 500 + [0.91] * 500}
    found = by_log(compare_pairs(pairs_of(ratios), RMSE))
    assert found[ALL_LOGS].pairs == 2 and not found[ALL_LOGS].is_worse
    assert found["a"].is_worse and found["b"].is_better


def test_false_alarms_among_many_comparisons_are_at_most_one_batch_in_twenty() -> None:
    rng = np.random.default_rng(1)
    alarms = 0
    for _ in range(300):
        ratios = {f"log {n}": list(np.exp(rng.normal(0, 0.1, 5))) for n in range(15)}
        alarms += any(one.is_worse or one.is_better for one in compare_pairs(pairs_of(ratios), RMSE))
    assert 1 <= alarms <= 26  # 15 expected with 16 independent tests; 26 is three sigma above


def test_more_sure_is_better_and_more_sure_and_wrong_is_worse() -> None:
    pairs = [
        (
            row("a", seed, 0.1, **{"confidence.sure": 0.9 + 0.001 * seed, "confidence.sure_and_wrong": 0.2}),
            row("a", seed, 0.1, **{"confidence.sure": 0.5, "confidence.sure_and_wrong": 0.1}),
        )
        for seed in range(4)
    ]
    found = {one.figure.name: one for one in compare_pairs(pairs)}
    assert found["confidence.sure"].is_better and found["confidence.sure_and_wrong"].is_worse
    assert found["confidence.sure"].loss == pytest.approx(-0.4015)


def test_logs_of_one_name_are_kept_apart() -> None:
    pairs = pairs_of({"drive": [1.0, 2.0]}) + [
        (here | {"log_id": "another"}, there | {"log_id": "another"}) for here, there in pairs_of({"drive": [3.0, 4.0]})
    ]
    assert {one.log for one in compare_pairs(pairs, RMSE)} == {ALL_LOGS, "drive id of ", "drive anothe"}


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


HERE = [row("a", seed, 0.1) for seed in range(3)]
PATH = Path("there")


def test_pairs_are_of_the_same_content_and_seed_in_any_order() -> None:
    there = [row("renamed", 1, 0.1, log_id="id of a"), row("a", 0, 0.1, log_id="recorded anew"), row("a", 7, 0.1)]
    verdict = compare_with(HERE, there, PATH)
    assert (verdict.pairs, verdict.alone, verdict.alone_there) == (1, 2, 2)


def test_a_run_that_fails_and_did_not_there_is_a_loss() -> None:
    failed = [*HERE[:2], row("a", 2, None)]
    verdict = compare_with(failed, HERE, PATH)
    assert verdict.is_loss and [one["seed"] for one in verdict.newly_failed] == [2]
    assert not compare_with(HERE, failed, PATH).is_loss
    assert not compare_with(failed, failed, PATH).is_loss


def test_settings_tell_pairs_apart_where_both_sides_share_a_value() -> None:
    def runs(name: str, *values: str) -> list[dict[str, object]]:
        return [row("a", 0, 0.1, **{f"set.{name}": value}) for value in values]

    kinds = runs("observation.kind", "line", "slope")
    assert compare_with(kinds, kinds, PATH).pairs == 2
    assert compare_with(kinds[:1], kinds, PATH).pairs == 1
    assert compare_with(runs("mcl.particles", "500"), runs("mcl.particles", "600"), PATH).pairs == 1


def test_runs_that_cannot_be_told_apart_or_have_no_counterpart_are_refused() -> None:
    twice = [row("a", 0, 0.1, **{"set.mcl.particles": value}) for value in ("500", "600")]
    with pytest.raises(InputError, match="there: expected one run for each log and seed on either side, found two"):
        compare_with(HERE, twice, PATH)
    with pytest.raises(InputError, match="there: expected runs of the same logs"):
        compare_with(HERE, [row("b", 0, 0.1)], PATH)
