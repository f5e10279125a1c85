"""Tables of many runs, and what is wrong with a file is said."""

from __future__ import annotations

from pathlib import Path

import pytest
from batches import row

from localiser.errors import InputError
from localiser.storage import read_figures, read_runs, write_runs_csv

ROWS = [
    row("a, b", 0, 0.125, frames=205, **{"set.mcl.particles": "500", "nees_mean": 3}),
    row("c", 1, None, **{"set.mcl.particles": "600"}),
]


def test_a_table_gives_the_rows_back(tmp_path: Path) -> None:
    write_runs_csv(tmp_path / "runs.csv", ROWS)
    expected = [one | {"frames": one.get("frames"), "nees_mean": one.get("nees_mean")} for one in ROWS]
    assert read_runs(tmp_path / "runs.csv") == expected


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("log,log_id,seed,nees_mean\nhouse,x,0,good\n", r"runs\.csv:2: nees_mean: expected a number .* found 'good'"),
        ("log,log_id,seed\nhouse,x,first\n", r"runs\.csv:2: seed: expected a number .* found 'first'"),
        ("log,seed\nhouse,0\n", "expected a column 'log_id'"),
        ("log,log_id,seed\n", "expected at least one run, found none"),
    ],
)
def test_a_bad_table_is_refused_by_line_and_column(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "runs.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_runs(tmp_path / "runs.csv")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"frames": "many"}', "frames: expected a whole number, found 'many'"),
        ('{"frames": 1.5}', "frames: expected a whole number, found 1.5"),
        ('{"nees_mean": [1]}', r"nees_mean: expected a number, found \[1\]"),
        ('{"nees_mean": 1e400}', "nees_mean: expected a number, found inf"),
        ('{"map": 3}', "map: expected a text, found 3"),
    ],
)
def test_figures_of_another_type_are_told(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "row.json").write_text(text)
    with pytest.raises(InputError, match=said):
        read_figures(tmp_path / "row.json")


def test_a_name_that_is_no_text_fits_into_the_table(tmp_path: Path) -> None:
    rows = [row("a", 0, 0.1, log_path="b\udcff")]
    write_runs_csv(tmp_path / "runs.csv", rows)
    assert read_runs(tmp_path / "runs.csv")[0]["log_path"] == "b\\udcff"
