"""A table of results, written for the terminal, as CSV, and as Markdown."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.table import Table

from localiser.storage import csv_of


@dataclass(frozen=True, slots=True)
class Sheet:
    """name: of its file. title, note: what it shows, and what to make of it. columns (all different), rows: texts."""

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def csv(self) -> str:
        """Return the table as CSV."""
        return csv_of([_one_line(self.columns), *self.rows])

    def markdown(self) -> str:
        """Return title, table and note as Markdown."""
        rule = ("---", *("---:" for _ in self.columns[1:]))
        lines = [f"| {' | '.join(_one_line(row))} |" for row in (self.columns, rule, *self.rows)]
        return "\n".join([f"## {self.title}", "", *lines, *(["", self.note] if self.note else []), ""])

    def table(self) -> Table:
        """Return the table for a terminal."""
        table = Table(title=self.title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False)
        table.caption, table.caption_justify = self.note or None, "left"
        for index, column in enumerate(self.columns):
            table.add_column(column, justify="right" if index else "left", vertical="bottom")
        for row in self.rows:
            table.add_row(*row)
        return table


def _one_line(cells: Iterable[str]) -> list[str]:
    return [cell.replace("\n", " ") for cell in cells]
