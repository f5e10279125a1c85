"""Tables of the command line: all look alike, and columns that do not fit the terminal go on in a further table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


def new_table(title: str, *columns: str, texts: int = 1) -> Table:
    """Return an empty table; the first `texts` columns hold texts, the others numbers, which stand right."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title or None, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for place, column in enumerate(columns):
        table.add_column(column, justify="left" if place < texts else "right", vertical="bottom")
    return table


def fit_width(table: Table, console: Console) -> list[Table]:
    """Return the table in pieces that are as wide as the console at most, where its columns can be.

    Each piece begins with the columns that tell the rows apart. Title and caption stand once. A table without a
    header is a list of texts, whose lines are wrapped instead.
    """
    if not table.show_header or _width(table, console) <= console.width:
        return [table]
    count = len(table.columns)
    keys = _keys(table)
    pieces: list[Table] = []
    start = keys
    while start < count:
        end = start + 1
        while end < count and _width(_part(table, [*range(keys), *range(start, end + 1)]), console) <= console.width:
            end += 1
        pieces.append(_part(table, [*range(keys), *range(start, end)]))
        start = end
    pieces = pieces or [table]
    pieces[0].title, pieces[-1].caption = table.title, table.caption
    return pieces


def _keys(table: Table) -> int:
    """Return how many columns at the beginning tell the rows apart."""
    columns = [[str(cell) for cell in column.cells] for column in table.columns]
    rows = len(table.rows)
    return next((k for k in range(1, len(columns)) if len(set(zip(*columns[:k], strict=True))) == rows), 1)


def _part(table: Table, chosen: Sequence[int]) -> Table:
    """Return a table with these columns alone."""
    from copy import copy

    part = copy(table)
    part.title = part.caption = None
    part.columns = []
    part.rows = []
    columns = [table.columns[index] for index in chosen]
    for column in columns:
        part.add_column(column.header, justify=column.justify, vertical=column.vertical, style=column.style)
    for row, cells in zip(table.rows, zip(*(column.cells for column in columns), strict=True), strict=True):
        part.add_row(*cells, style=row.style, end_section=row.end_section)
    return part


def _width(table: Table, console: Console) -> int:
    """Return the width of the columns, which that of title and caption does not change."""
    from rich.measure import Measurement

    return Measurement.get(console, console.options.update(width=10_000), table).maximum
