"""Tables of many runs, a row a run: CSV for people and spreadsheets, Parquet for programs. They hold the same.

A column is text, a whole number or a number, by its name alone, so that tables of other runs can be put together. What
is not known is an empty cell, or null.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from localiser.documents import encodable, field_name, read_bytes, shown, write_bytes, write_text
from localiser.errors import InputError
from localiser.storage.runs import read_json
from localiser.storage.tables import MAX_TABLE_BYTES, MOST_CELLS, Column, csv_of, read_table

Row = Mapping[str, Any]

CHOICE = "set."
"""How the names begin of columns that say what was chosen for a run."""

TEXTS = (
    "run", "log", "log_path", "log_id", "config", "error", "folder", "warnings", "confidence.reasons",
    "observation", "association", "odometry", "start", "map", "inputs", "version",
)  # fmt: skip
INTEGERS = ("seed", "frames", "particles")
_LARGEST = 2**62
_REQUIRED = ("log", "log_id", "seed")


def csv_text(rows: Sequence[Row]) -> str:
    """Return the table of rows as CSV; its columns are in the order in which rows have them."""
    names = _columns(rows)
    return csv_of([names, *([_cell(row.get(name)) for name in names] for row in rows)])


def write_runs_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write the table of rows as CSV. Raises OutputError."""
    write_text(path, csv_text(rows))


def write_runs_parquet(path: Path, rows: Sequence[Row]) -> None:
    """Write the table of rows as Parquet. Raises OutputError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    types = {str: pa.string(), int: pa.int64(), float: pa.float64()}
    columns = {
        name: pa.array([_typed(name, row.get(name)) for row in rows], type=types[_type_of(name)])
        for name in _columns(rows)
    }
    buffer = io.BytesIO()
    pq.write_table(pa.table(columns), buffer)
    write_bytes(path, buffer.getvalue())


def read_figures(path: Path) -> dict[str, Any]:
    """Return the figures of one run that a JSON file holds, as tables have them: by name. Raises InputError."""
    figures = read_json(path)
    for name, value in figures.items():
        kind = _type_of(name)
        if not _is_of(kind, value) and value is not None:
            expected = {str: "a text", int: "a whole number", float: "a number"}[kind]
            raise InputError(f"expected {expected}, found {shown(value)}", path=path, field=field_name((name,)))
    return figures


def _is_of(kind: type, value: Any) -> bool:
    if kind is str:
        return isinstance(value, str)
    if not isinstance(value, (int, float)) or not abs(value) < _LARGEST:
        return False
    return kind is float or value == int(value)


def read_runs(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a table (CSV, or Parquet by the ending .parquet), None where something is not known.

    Raises InputError.
    """
    rows = _read_parquet(path) if path.suffix == ".parquet" else _read_csv(path)
    if not rows:
        raise InputError("expected at least one run, found none", path=path)
    return rows


def _read_csv(path: Path) -> list[dict[str, Any]]:
    table = read_table(path, [Column(name, str) for name in _REQUIRED], more_columns=True)
    rows: list[dict[str, Any]] = []
    for index in range(len(table)):
        row: dict[str, Any] = {}
        for name, cells in table.columns.items():
            try:
                row[name] = _parsed(name, cells[index])
            except ValueError:
                problem = f"expected a number or an empty cell, found {cells[index]!r}"
                raise table.error(index, name, problem) from None
        rows.append(row)
    return rows


def _read_parquet(path: Path) -> list[dict[str, Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(pa.BufferReader(read_bytes(path, MAX_TABLE_BYTES)))
        cells = file.metadata.num_rows * file.metadata.num_columns  # a few bytes can stand for a billion of them
        if cells > MOST_CELLS:
            raise InputError(f"expected at most {MOST_CELLS} cells, found {cells}", path=path)
        table = file.read()
        for name in _REQUIRED:
            if name not in table.column_names:
                raise InputError("expected such a column, found none", path=path, field=name)
        columns = {name: _checked(name, table.column(name)) for name in table.column_names}
    except (OSError, TypeError, ValueError, KeyError, pa.ArrowException) as error:
        raise InputError(f"expected a Parquet file of runs, found something else: {error}", path=path) from None
    return [dict(zip(columns, cells, strict=True)) for cells in zip(*columns.values(), strict=True)]


def _checked(name: str, column: Any) -> list[Any]:
    """Return the cells of a column, None where not known. Raises TypeError, ArrowException for another type."""
    import pyarrow as pa

    types = {str: pa.string(), int: pa.int64(), float: pa.float64()}
    kind = _type_of(name)
    if kind is not str and pa.types.is_string(column.type):
        raise TypeError(f"{shown(name)} is text")
    cells: list[Any] = column.cast(types[kind]).to_pylist()
    return [None if isinstance(cell, float) and not math.isfinite(cell) else cell for cell in cells]


def _columns(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row))


def _type_of(name: str) -> type:
    if name in TEXTS or name.startswith(CHOICE):
        return str
    return int if name in INTEGERS else float


def _typed(name: str, value: Any) -> Any:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return None
    typed = _type_of(name)(value)
    return encodable(typed) if isinstance(typed, str) else typed


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return str(int(value)) if isinstance(value, bool) else str(value)


def _parsed(name: str, cell: str) -> Any:
    if not cell:
        return None
    value = _type_of(name)(cell)
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError
    return value
