"""Read tables: CSV with a header line, or columns between white space as other programs write them."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from localiser.documents import nearest, plain_name, read_text, shown
from localiser.errors import InputError
from localiser.geometry import Array

Value = TypeVar("Value")
MAX_TABLE_BYTES = 64 * 2**20  # a million rows of odometry
MOST_COLUMNS, MOST_CELLS = 1000, 20_000_000  # of a table; a cell takes some 60 bytes of memory
_LARGEST = 1e9  # metres, radians, pixels: beyond it a number is a mistake, and squares of it still fit a float


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table: its name, how a cell is read, and whether the header must have it."""

    name: str
    read: Callable[[str], Any]
    required: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """R rows. columns: by name, lists of R cells; optional ones may be absent. lines: (R,) line of each in the file."""

    path: Path
    columns: dict[str, list[Any]]
    lines: list[int]

    def __len__(self) -> int:
        return len(self.lines)

    def integers(self, name: str) -> NDArray[np.int64]:
        """Return a column (R,) of integers."""
        return np.array(self.columns[name], dtype=np.int64)

    def numbers(self, *names: str) -> Array:
        """Return columns (R,), or (R, names) when several are asked for."""
        columns = [np.array(self.columns[name], dtype=np.float64) for name in names]
        return columns[0] if len(columns) == 1 else np.stack(columns, axis=-1)

    def error(self, row: int, name: str, problem: str) -> InputError:
        """Return the error that says what is wrong with a cell."""
        return InputError(problem, path=self.path, line=self.lines[row], field=name)

    def require_time_order(self, name: str = "t_ns", *, strictly: bool) -> None:
        """Raise InputError at the first row whose time (ns) is before the one above it, or the same if `strictly`."""
        then = "after" if strictly else "not before"
        for row, (before, time) in enumerate(pairwise(self.columns[name]), start=1):
            if time < before or (strictly and time == before):
                expected, found = self.written(row - 1, name), self.written(row, name)
                raise self.error(row, name, f"expected a time {then} {expected}, found {found}")

    def written(self, row: int, name: str) -> str:
        """Return a cell as the file has it; its value where the cell is not to be found."""
        lines = io.StringIO(read_text(self.path, MAX_TABLE_BYTES), newline="").readlines()
        line = lines[self.lines[row] - 1]
        cells, place = line.split("," if "," in line else None), list(self.columns).index(name)
        return cells[place].strip() if len(cells) >= len(self.columns) else str(self.columns[name][row])


# -- cells: each returns the value or raises ValueError with what was expected -----------------------------------------


def plain(cell: str) -> str:
    """Return the cell if it holds nothing that Python reads as a number and other programs do not."""
    if "_" in cell or not cell.isascii() or len(cell) > 100:
        raise ValueError
    return cell


def number(cell: str) -> float:
    """Return a finite number."""
    try:
        value = float(plain(cell))
    except ValueError:
        raise ValueError("a number") from None
    if not math.isfinite(value):
        raise ValueError("a finite number")
    return _within(value, abs(value) <= _LARGEST, f"a number within ±{_LARGEST:.0e}")


def number_or_unknown(cell: str) -> float:
    """Return a finite number, nan for an empty cell."""
    return number(cell) if cell.strip() else math.nan


def number_or_lost(cell: str) -> float:
    """Return a number, nan for what programs write where they know none."""
    return math.nan if cell.strip().lower() in ("", "nan", "-nan", "null", "none") else number(cell)


def positive_or_unknown(cell: str) -> float:
    """Return a number above 0, nan for an empty cell."""
    value = number_or_unknown(cell)
    return _within(value, not value <= 0, "a number above 0")


def integer(cell: str) -> int:
    """Return an integer that fits 62 bits, so that the difference of two never overflows."""
    try:
        value = int(plain(cell))
    except ValueError:
        raise ValueError("an integer") from None
    return _within(value, abs(value) < 2**62, "an integer below 2^62")


def name_or_none(cell: str) -> str:
    """Return a name, "" for an empty cell or -1."""
    return "" if cell.strip() in ("", "-1") else plain_name(text(cell))


def sign(cell: str) -> int:
    """Return +1, -1, or 0, which is also what an empty cell means."""
    return int(_within(cell.strip(), cell.strip() in ("", "-1", "0", "1", "+1"), "1, -1 or 0") or 0)


def text(cell: str) -> str:
    """Return a name of at most 255 characters."""
    _within(cell, bool(cell.strip()), "a name")
    return _within(cell, len(cell) <= 255, "a name of at most 255 characters").strip()


def _within(value: Value, is_right: bool, expected: str) -> Value:
    if not is_right:
        raise ValueError(expected)
    return value


def csv_of(rows: Iterable[Iterable[Any]]) -> str:
    """Return rows of cells as CSV; None is an empty cell."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


# -- files ------------------------------------------------------------------------------------------------------------


def read_table(path: Path, columns: Sequence[Column], *, rows_at_least: int = 0, more_columns: bool = False) -> Table:
    """Return the table in a CSV file, with the columns in any order.

    more_columns: whether columns that are not listed are kept, as text. Raises InputError with file, line and field.
    """
    reader = csv.reader(io.StringIO(read_text(path, MAX_TABLE_BYTES), newline=""), strict=True)
    try:
        rows = _bounded(path, ((reader.line_num, cells) for cells in reader if cells))
    except csv.Error as error:
        raise InputError(f"not valid CSV: {error}", path=path, line=reader.line_num) from None
    wanted = repr(",".join(column.name for column in columns if column.required))
    if not rows:
        raise InputError(f"expected the header {wanted}, found an empty file", path=path)
    (line, header), *body = rows
    names, known = [cell.strip() for cell in header], {column.name: column for column in columns}
    counts = Counter(names)
    for name in names:
        if counts[name] > 1:
            raise InputError("column given twice", path=path, line=line, field=shown(name))
        if name not in known and not (more_columns and name):
            raise InputError(f"unknown column; {nearest(name, list(known))}", path=path, line=line, field=shown(name))
    for column in columns:
        if column.required and column.name not in names:
            problem = f"expected a column {column.name!r} in the header {wanted}, found {shown(','.join(names))}"
            raise InputError(problem, path=path, line=line)
    if len(body) < rows_at_least:
        raise InputError(f"expected at least {rows_at_least} rows after the header, found {len(body)}", path=path)
    return _table(path, [known.get(name, Column(name, str)) for name in names], body, "cells")


def read_columns(path: Path, columns: Sequence[Column], separator: str | None = None) -> Table:
    """Return the table, at least one row, in a file of these columns without a header, # before comments.

    separator: None: white space, between exactly these columns; else more columns may follow. Raises InputError with
    file, line and field.
    """
    lines = enumerate(io.StringIO(read_text(path, MAX_TABLE_BYTES), newline=""), start=1)
    most = None if separator is None else len(columns)
    rows = _bounded(
        path,
        (
            (line, text.strip().split(separator)[:most])
            for line, text in lines
            if text.strip() and not text.lstrip().startswith("#")
        ),
    )
    if not rows:
        raise InputError("expected at least one row, found none", path=path)
    return _table(path, columns, rows, f"columns ({', '.join(column.name for column in columns)})")


def _bounded(path: Path, rows: Iterable[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """Return rows, each with its line. Raises InputError before they take more memory than a table may."""
    found, left = [], MOST_CELLS
    for line, cells in rows:
        if len(cells) > MOST_COLUMNS:
            raise InputError(f"expected at most {MOST_COLUMNS} columns, found {len(cells)}", path=path, line=line)
        left -= len(cells)
        if left < 0:
            raise InputError(f"expected at most {MOST_CELLS} cells, found more", path=path, line=line)
        found.append((line, cells))
    return found


def _table(path: Path, columns: Sequence[Column], rows: Sequence[tuple[int, list[str]]], what: str) -> Table:
    """Return the table of rows of cells, each with its line. what: a row consists of, for errors."""
    for line, cells in rows:
        if len(cells) != len(columns):
            raise InputError(f"expected {len(columns)} {what}, found {len(cells)}", path=path, line=line)
    values: dict[str, list[Any]] = {column.name: [] for column in columns}
    for place, column in enumerate(columns):
        for line, cells in rows:
            try:
                values[column.name].append(column.read(cells[place]))
            except ValueError as error:
                found = shown(cells[place]) if cells[place].strip() else "an empty cell"
                raise InputError(f"expected {error}, found {found}", path=path, line=line, field=column.name) from None
    return Table(path, values, [line for line, _ in rows])
