"""Tables: CSV with a header line, in log folders and results; columns between white space, from other programs."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.documents import nearest, read_text, shown
from localiser.errors import InputError
from localiser.geometry import Array

MAX_TABLE_BYTES = 64 * 2**20  # a million rows of odometry
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
        times = self.columns[name]
        unit = "" if name.endswith("_ns") else " ns"  # the file has another
        for row in range(1, len(times)):
            if times[row] < times[row - 1] or (strictly and times[row] == times[row - 1]):
                then = "after" if strictly else "not before"
                problem = f"expected a time {then} {times[row - 1]}{unit}, found {times[row]}{unit}"
                raise self.error(row, name, problem)


# -- cells: each returns the value or raises ValueError with what was expected -----------------------------------------


def number(cell: str) -> float:
    """Return a finite number."""
    try:
        value = float(plain(cell))
    except ValueError:
        raise ValueError("a number") from None
    if not math.isfinite(value):
        raise ValueError("a finite number")
    if abs(value) > _LARGEST:
        raise ValueError(f"a number within ±{_LARGEST:.0e}")
    return value


def number_or_unknown(cell: str) -> float:
    """Return a finite number, nan for an empty cell."""
    return number(cell) if cell.strip() else math.nan


def positive_or_unknown(cell: str) -> float:
    """Return a number above 0, nan for an empty cell."""
    value = number_or_unknown(cell)
    if value <= 0:
        raise ValueError("a number above 0")
    return value


def integer(cell: str) -> int:
    """Return an integer that fits 62 bits, so that the difference of two never overflows."""
    try:
        value = int(plain(cell))
    except ValueError:
        raise ValueError("an integer") from None
    if abs(value) >= 2**62:
        raise ValueError("an integer below 2^62")
    return value


def integer_or_none(cell: str) -> int:
    """Return an integer from -1 on, -1 for an empty cell."""
    value = integer(cell) if cell.strip() else -1
    if value < -1:
        raise ValueError("an integer from -1 on")
    return value


def sign(cell: str) -> int:
    """Return +1, -1, or 0, which is also what an empty cell means."""
    if cell.strip() not in ("", "-1", "0", "1", "+1"):
        raise ValueError("1, -1 or 0")
    return int(cell.strip() or 0)


def text(cell: str) -> str:
    """Return a name of at most 255 characters."""
    if not cell.strip():
        raise ValueError("a name")
    if len(cell) > 255:
        raise ValueError("a name of at most 255 characters")
    return cell.strip()


def plain(cell: str) -> str:
    """Return the cell if it holds nothing that Python reads as a number and other programs do not."""
    if "_" in cell or not cell.isascii() or len(cell) > 100:
        raise ValueError
    return cell


# -- files ------------------------------------------------------------------------------------------------------------


def read_table(path: Path, columns: Sequence[Column], *, rows_at_least: int = 0, more_columns: bool = False) -> Table:
    """Return the table in a CSV file, with the columns in any order.

    more_columns: whether columns that are not listed are kept, as text. Raises InputError with file, line and field.
    """
    reader = csv.reader(io.StringIO(read_text(path, MAX_TABLE_BYTES), newline=""), strict=True)
    try:
        rows = [(reader.line_num, cells) for cells in reader if cells]
    except csv.Error as error:
        raise InputError(f"not valid CSV: {error}", path=path, line=reader.line_num) from None
    if not rows:
        raise InputError(f"expected the header {_header(columns)}, found an empty file", path=path)
    found = _checked_header(path, rows[0], columns, more_columns)
    body = rows[1:]
    if len(body) < rows_at_least:
        raise InputError(f"expected at least {rows_at_least} rows after the header, found {len(body)}", path=path)
    for line, cells in body:
        if len(cells) != len(found):
            raise InputError(f"expected {len(found)} cells, found {len(cells)}", path=path, line=line)
    values = {
        column.name: _column(path, column, [(line, cells[place]) for line, cells in body])
        for place, column in enumerate(found)
    }
    return Table(path, values, [line for line, _ in body])


def read_columns(path: Path, columns: Sequence[Column]) -> Table:
    """Return the table, at least one row, in a file of exactly these columns between white space, # before comments.

    Raises InputError with file, line and field.
    """
    rows = []
    for line, content in enumerate(read_text(path, MAX_TABLE_BYTES).split("\n"), start=1):
        cells = content.split()
        if not cells or cells[0].startswith("#"):
            continue
        if len(cells) != len(columns):
            wanted = f"{len(columns)} columns ({', '.join(column.name for column in columns)})"
            raise InputError(f"expected {wanted}, found {len(cells)}", path=path, line=line)
        rows.append((line, cells))
    if not rows:
        raise InputError("expected at least one row, found none", path=path)
    values = {
        column.name: _column(path, column, [(line, cells[place]) for line, cells in rows])
        for place, column in enumerate(columns)
    }
    return Table(path, values, [line for line, _ in rows])


def _column(path: Path, column: Column, cells: list[tuple[int, str]]) -> list[Any]:
    values = []
    for line, cell in cells:
        try:
            values.append(column.read(cell))
        except ValueError as error:
            found = shown(cell) if cell.strip() else "an empty cell"
            raise InputError(f"expected {error}, found {found}", path=path, line=line, field=column.name) from None
    return values


def _checked_header(
    path: Path, header: tuple[int, list[str]], columns: Sequence[Column], more_columns: bool
) -> list[Column]:
    """Return the columns in the order of the file."""
    line, names = header[0], [cell.strip() for cell in header[1]]
    known = {column.name: column for column in columns}
    for name in names:
        if names.count(name) > 1:
            raise InputError("column given twice", path=path, line=line, field=shown(name))
        if name not in known and not (more_columns and name):
            raise InputError(f"unknown column; {nearest(name, list(known))}", path=path, line=line, field=shown(name))
    for column in columns:
        if column.required and column.name not in names:
            found = shown(",".join(names))
            raise InputError(
                f"expected a column {column.name!r} in the header {_header(columns)}, found {found}",
                path=path,
                line=line,
            )
    return [known.get(name, Column(name, str)) for name in names]


def _header(columns: Sequence[Column]) -> str:
    return repr(",".join(column.name for column in columns if column.required))
