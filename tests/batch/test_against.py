"""Which runs of two batches are pairs, and when that is a loss."""

from __future__ import annotations

from pathlib import Path

import pytest
from batches import row

from localiser.batch import compare_with
from localiser.errors import InputError

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
