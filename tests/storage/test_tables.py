"""CSV tables: every wrong cell is named with file, line and field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from localiser.errors import InputError
from localiser.storage import tables
from localiser.storage.tables import (
    Column,
    integer,
    name_or_none,
    number,
    number_or_unknown,
    positive_or_unknown,
    read_table,
    sign,
    text,
)

COLUMNS = (Column("t_ns", integer), Column("x", number), Column("note", text, required=False))


def problem(tmp_path: Path, content: str | bytes, **options: object) -> str:
    path = tmp_path / "table.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError) as caught:
        read_table(path, COLUMNS, **options).require_time_order(strictly=True)  # type: ignore[arg-type]
    return str(caught.value).removeprefix(f"{tmp_path}/")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "table.csv: expected the header 't_ns,x', found an empty file"),
        ("t_s,x\n", "table.csv:1: 't_s': unknown column; the nearest known is 't_ns'"),
        ("t_ns\n1\n", "table.csv:1: expected a column 'x' in the header 't_ns,x', found 't_ns'"),
        ("t_ns,x,x\n", "table.csv:1: 'x': column given twice"),
        ("t_ns,x,\n", "table.csv:1: '': unknown column"),
        ("t_ns,x\n1,2\n3\n", "table.csv:3: expected 2 cells, found 1"),
        ("t_ns,x\n1,2\n1.5,2\n", "table.csv:3: t_ns: expected an integer, found '1.5'"),
        ("t_ns,x\n1e9,2\n", "table.csv:2: t_ns: expected an integer, found '1e9'"),
        (f"t_ns,x\n{2**62},2\n", "table.csv:2: t_ns: expected an integer below 2^62"),
        ("t_ns,x\n1,nan\n", "table.csv:2: x: expected a finite number, found 'nan'"),
        ("t_ns,x\n1,-inf\n", "table.csv:2: x: expected a finite number, found '-inf'"),
        ("t_ns,x\n1,1e300\n", "table.csv:2: x: expected a number within ±1e+09, found '1e300'"),
        ("t_ns,x\n1,1_0\n", "table.csv:2: x: expected a number, found '1_0'"),
        ("t_ns,x\n1,١\n", "table.csv:2: x: expected a number, found '١'"),
        ("t_ns,x\n1,\n", "table.csv:2: x: expected a number, found an empty cell"),
        ("t_ns,x\n\n5,2\n4,2\n", "table.csv:4: t_ns: expected a time after 5, found 4"),
        ("t_ns,x\n5,2\n5,2\n", "table.csv:3: t_ns: expected a time after 5, found 5"),
        ('t_ns,x\n1,"2\n', "table.csv:2: not valid CSV"),
        (b"t_ns,x\n1,\xff\n", "table.csv:2: expected UTF-8 text, found byte 0xff"),
    ],
)
def test_errors_name_line_field_and_what_was_found(tmp_path: Path, content: str | bytes, expected: str) -> None:
    assert problem(tmp_path, content).startswith(expected)


def test_too_few_rows(tmp_path: Path) -> None:
    found = problem(tmp_path, "t_ns,x\n", rows_at_least=1)
    assert found == "table.csv: expected at least 1 rows after the header, found 0"


def test_columns_come_in_any_order_with_any_line_ends(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(b'\xef\xbb\xbfx, note ,t_ns\r\n 1.5,"a,b",-3\r\n2e-1,c,4\r\n')
    table = read_table(path, COLUMNS)
    np.testing.assert_array_equal(table.integers("t_ns"), [-3, 4])
    np.testing.assert_array_equal(table.numbers("x"), [1.5, 0.2])
    assert table.columns["note"] == ["a,b", "c"]
    assert table.lines == [2, 3]


def test_columns_of_a_newer_version_are_kept_as_text(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("t_ns,x,later\n1,2,hello\n")
    assert read_table(path, COLUMNS, more_columns=True).columns["later"] == ["hello"]


def test_cells_that_may_be_empty() -> None:
    assert np.isnan(number_or_unknown(" "))
    assert np.isnan(positive_or_unknown(""))
    assert (name_or_none(""), name_or_none("-1"), name_or_none(" door ")) == ("", "", "door")
    assert [sign(cell) for cell in ("", "0", "1", "+1", "-1")] == [0, 0, 1, 1, -1]


@pytest.mark.parametrize(
    ("read", "cell"),
    [(positive_or_unknown, "0"), (positive_or_unknown, "-1"), (name_or_none, "x" * 256), (sign, "2"), (text, " ")],
)
def test_cells_out_of_range_are_refused(read: object, cell: str) -> None:
    with pytest.raises(ValueError):
        read(cell)  # type: ignore[operator]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("t_ns,x\n" + "," * 5000, "table.csv:2: expected at most 1000 columns, found 5001"),
        (",".join(f"c{k}" for k in range(100_000)), "expected at most 1000 columns, found 100000"),
    ],
)
def test_columns_are_limited(tmp_path: Path, content: str, said: str) -> None:
    assert said in problem(tmp_path, content)


def test_cells_are_limited_before_they_fill_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "MOST_CELLS", 10)
    assert "table.csv:6: expected at most 10 cells, found more" in problem(tmp_path, "t_ns,x\n" + "1,2\n" * 9)
