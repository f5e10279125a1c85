"""Combinations of configurations, settings and seeds."""

from __future__ import annotations

from pathlib import Path

import pytest

from localiser.batch import choices_of, seeds_of
from localiser.batch.choices import values_of
from localiser.errors import InputError


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
