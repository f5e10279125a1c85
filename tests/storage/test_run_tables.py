"""Tables of many runs: CSV and Parquet hold the same, and what is wrong with a file is said."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from batches import row

from localiser.errors import InputError
from localiser.storage import read_figures, read_runs, run_tables, write_runs_csv, write_runs_parquet

ROWS = [
    row("a, b", 0, 0.125, frames=205, **{"set.mcl.particles": "500", "nees_mean": 3}),
    row("c", 1, None, **{"set.mcl.particles": "600"}),
]


def test_csv_and_parquet_give_the_rows_back(tmp_path: Path) -> None:
    write_runs_csv(tmp_path / "runs.csv", ROWS)
    write_runs_parquet(tmp_path / "runs.parquet", ROWS)
    expected = [one | {"frames": one.get("frames"), "nees_mean": one.get("nees_mean")} for one in ROWS]
    assert read_runs(tmp_path / "runs.csv") == read_runs(tmp_path / "runs.parquet") == expected


def test_types_of_parquet_columns_do_not_depend_on_the_rows(tmp_path: Path) -> None:
    write_runs_parquet(tmp_path / "all.parquet", ROWS)
    write_runs_parquet(tmp_path / "none.parquet", [dict.fromkeys(ROWS[0])])
    full, empty = (pq.read_schema(tmp_path / f"{name}.parquet") for name in ("all", "none"))
    assert [str(full.field(name).type) for name in ("log", "seed", "set.mcl.particles", "nees_mean")] == [
        "string", "int64", "string", "double",
    ]  # fmt: skip
    assert full.equals(empty)


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


def test_what_is_no_parquet_is_refused(tmp_path: Path) -> None:
    (tmp_path / "runs.parquet").write_bytes(b"no parquet")
    with pytest.raises(InputError, match=r"runs\.parquet: expected a Parquet file"):
        read_runs(tmp_path / "runs.parquet")
    with pytest.raises(InputError, match="no such file"):
        read_runs(tmp_path / "none.parquet")


@pytest.mark.parametrize(
    ("name", "cells", "said"),
    [
        ("seed", pa.array(["one"]), "'seed' is text"),
        ("nees_mean", pa.array([[1.0]]), "expected a Parquet file of runs"),
        ("log", pa.array([[1.0]]), "expected a Parquet file of runs"),
        ("seed", pa.array([0.5]), "expected a Parquet file of runs"),
    ],
)
def test_cells_of_another_type_are_told(tmp_path: Path, name: str, cells: pa.Array, said: str) -> None:
    columns = {"log": pa.array(["a"]), "log_id": pa.array(["x"]), "seed": pa.array([0])} | {name: cells}
    pq.write_table(pa.table(columns), tmp_path / "runs.parquet")
    with pytest.raises(InputError, match=said):
        read_runs(tmp_path / "runs.parquet")


def test_cells_of_parquet_are_counted_before_memory_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A few bytes of such a file can stand for a billion of them."""
    write_runs_parquet(tmp_path / "runs.parquet", ROWS)
    monkeypatch.setattr(run_tables, "MOST_CELLS", 5)
    with pytest.raises(InputError, match="expected at most 5 cells, found 20"):
        read_runs(tmp_path / "runs.parquet")


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


def test_a_name_that_is_no_text_fits_into_both_tables(tmp_path: Path) -> None:
    rows = [row("a", 0, 0.1, log_path="b\udcff")]
    write_runs_csv(tmp_path / "runs.csv", rows)
    write_runs_parquet(tmp_path / "runs.parquet", rows)
    for name in ("runs.csv", "runs.parquet"):
        assert read_runs(tmp_path / name)[0]["log_path"] == "b\\udcff"
