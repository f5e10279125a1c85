"""Tables for the terminal: all look alike, columns that do not fit go on below; and the tables of runs.

No word is broken. The tables of runs tell what runs know of themselves, and their errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from localiser.evaluate.flat import figure_at
from localiser.evaluate.metrics import ABOUT

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

Metrics = Mapping[str, Any]
Value = float | None
_LONGEST_NAME = 24


def new_table(title: str, *columns: str, texts: int = 1) -> Table:
    """Return an empty table; the first `texts` columns hold texts, the others numbers, which stand right.

    All tables of the program are made by this.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title or None, title_justify="left", box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.collapse_padding = True
    for place, column in enumerate(columns):
        is_text = place < texts
        table.add_column(column, justify="left" if is_text else "right", vertical="bottom", no_wrap=not is_text)
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


# -- the tables of runs -----------------------------------------------------------------------------------------------


class Column(NamedTuple):
    """A figure: its title, its key in the metrics (dots for groups), how it is written, which of several is the worst.

    per: what the figure is multiplied by.
    """

    title: str
    key: str
    spec: str
    worst: Callable[[list[float]], float] = max
    per: float = 1.0

    def of(self, run: Metrics) -> Value:
        """Return the figure of a run, None where it is not known."""
        value = figure_at(run, self.key)
        if isinstance(value, Sequence):  # the pauses
            value = len(value)
        return None if value is None else float(value) * self.per

    def text(self, value: Value) -> str:
        """Return the figure as it is written."""
        return UNKNOWN if value is None else format(value, self.spec)


# In the order of reading: is it found, is it sure, by what, how exactly, how far, how fast.
OWN = (
    Column("found\n(s)", "confidence.found_s", ".1f"),
    Column("sure\n(%)", "confidence.sure", ".1f", min, 100.0),
    Column("match\n(%)", "edges_matched", ".0f", min, 100.0),
    Column("resid.\nχ²", "residuals.consistency", ".2f"),
    Column("3σ\n(m)", "position_3sigma_median_m", ".3f"),
    Column("worst\n(m)", "position_3sigma_max_m", ".3f"),
    Column("3σ\n(°)", "heading_3sigma_median_deg", ".2f"),
    Column("drive\n(m)", "distance_m", ".1f", min),
    Column("speed\n(m/s)", "speed_mean_m_s", ".2f"),
    Column("gaps", "pauses", ".0f"),
    Column("image\n(ms)", "frame_ms_median", ".0f"),
)
# How good, how bad, how sure of itself, how close to the limit.
ERRORS = (
    Column("RMSE\n(m)", "position_rmse_m", ".3f"),
    Column("median\n(m)", "position_median_m", ".3f"),
    Column("max\n(m)", "position_max_m", ".3f"),
    Column("end\n(m)", "position_end_m", ".3f"),
    Column("heading\n(°)", "heading_rmse_deg", ".2f"),
    Column("odom.\n(m)", "odometry_position_rmse_m", ".3f"),
    Column("wrong\n(%)", "confidence.sure_and_wrong", ".1f", per=100.0),
    Column("NEES", "nees_mean", ".1f"),
    Column("RMSE /\nbound", "efficiency", ".2f"),
)
TABLES = {
    "What the run knows of itself": OWN,
    "Errors against the truth, no alignment": ERRORS,
}
COLUMNS = (*OWN, *ERRORS)
NAMES = ("log", *ABOUT)
IN_TITLE = tuple(name for name in NAMES if name != "inputs")  # a fingerprint says something only where it differs
UNKNOWN = "–"


class Row(NamedTuple):
    """A run, or the median or worst of several: `metrics` of the one, `values` by key of the others."""

    name: str
    run: Metrics
    values: Mapping[str, Value] | None = None
    ends_group: bool = False

    def cell(self, column: Column) -> str:
        """Return a figure as it is written."""
        return column.text(column.of(self.run) if self.values is None else self.values[column.key])


def run_tables(runs: Mapping[str, Metrics]) -> Iterator[Table | str]:
    """Yield what is the same for all named runs, then their tables; figures that no run knows are left out.

    Of runs that differ by their seed alone, median and worst stand below them.
    """
    values = {key: {_text(run.get(key)) for run in runs.values()} for key in NAMES}
    same = {key: next(iter(found)) for key, found in values.items() if len(found) == 1 and key in IN_TITLE}
    if shared := ", ".join(f"{key} {value}" for key, value in same.items() if value != UNKNOWN):
        yield shared
    differing = [key for key in values if len(values[key]) > 1]
    rows = list(_rows(runs))
    for title, columns in TABLES.items():
        known = [column for column in columns if any(column.of(row.run) is not None for row in rows)]
        if not known:
            continue
        table = new_table(title, "run", *differing, *(column.title for column in known), texts=1 + len(differing))
        for row in rows:
            about = [_text(row.run.get(key)) if row.values is None else "" for key in differing]
            figures = (row.cell(column) for column in known)
            style = "bold" if row.values else None
            table.add_row(_broken(row.name), *about, *figures, style=style, end_section=row.ends_group)
        yield ""
        yield table


def summaries(runs: Sequence[Metrics]) -> dict[str, dict[str, Value]]:
    """Return the median and the worst of each column over the runs that know it."""
    median: dict[str, Value] = {}
    worst: dict[str, Value] = {}
    for column in (*OWN, *ERRORS):
        known = [value for run in runs if (value := column.of(run)) is not None]
        median[column.key] = float(np.median(known)) if known else None
        worst[column.key] = column.worst(known) if known else None
    return {"median": median, "worst": worst}


def _rows(runs: Mapping[str, Metrics]) -> Iterator[Row]:
    """Yield the runs, those of one kind together, and what several of a kind come to."""

    def kind(run: tuple[str, Metrics]) -> tuple[str, ...]:
        return tuple(_text(run[1].get(key)) for key in NAMES if key != "seed")

    for _, group in groupby(sorted(runs.items(), key=kind), key=kind):
        members = list(group)
        for place, (name, run) in enumerate(members, 1):
            yield Row(name, run, ends_group=place == len(members))
        if len(members) > 1:
            for name, values in summaries([run for _, run in members]).items():
                yield Row(name, {}, values, ends_group=name == "worst")


def _broken(name: str) -> str:
    """Return a path in lines of at most `_LONGEST_NAME` where it can be broken after slashes."""
    lines = [""]
    for part in name.replace("/", "/\n").split("\n"):
        if lines[-1] and len(lines[-1]) + len(part) > _LONGEST_NAME:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)


def _text(value: object) -> str:
    return UNKNOWN if value is None else str(value)
