"""Tables of many runs as CSV, a row a run.

A column is text, a whole number or a number, by its name alone, so that tables of other runs can be put together. What
is not known is an empty cell.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from localiser.documents import field_name, shown, write_text
from localiser.errors import InputError, one_paragraph
from localiser.storage.runs import read_json
from localiser.storage.tables import Column, csv_of, read_table

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
    """Return the rows of a table, None where something is not known. Raises InputError."""
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
    if not rows:
        raise InputError("expected at least one run, found none", path=path)
    return rows


def _columns(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row))


def _type_of(name: str) -> type:
    if name in TEXTS or name.startswith(CHOICE):
        return str
    return int if name in INTEGERS else float


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return str(int(value)) if isinstance(value, bool) else str(value)


def _parsed(name: str, cell: str) -> Any:
    if not cell:
        return None
    kind = _type_of(name)
    value = one_paragraph(cell) if kind is str else kind(cell)
    if not isinstance(value, str) and not abs(value) < _LARGEST:
        raise ValueError
    return value
