"""Comparisons in pairs: intervals against scipy, Holm's correction, what is worse."""

from __future__ import annotations

import numpy as np
import pytest
from batches import row
from scipy import stats

from localiser.batch.compare import ALL_LOGS, COMPARED, Comparison, compare_pairs, holm

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
