"""Print the figures of one run or several as tables in the terminal: what runs know of themselves, and their errors.

Where tables do not fit the width of the terminal, columns go on in a further table. Several runs then get numbers, and
a table of its own says what each is. No word is broken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from localiser.evaluate.flat import figure_at
from localiser.evaluate.metrics import ABOUT

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult
    from rich.table import Table

Metrics = Mapping[str, Any]
Value = float | None


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
    number: int | None
    run: Metrics
    values: Mapping[str, Value] | None = None
    ends_group: bool = False

    def cell(self, column: Column) -> str:
        """Return a figure as it is written."""
        return column.text(column.of(self.run) if self.values is None else self.values[column.key])


class RunTables:
    """The tables of named runs, as rich prints them; where several runs differ by their seed alone, their median too.

    What is the same for all runs stands above the tables, and figures that no run knows are left out.
    """

    def __init__(self, runs: Mapping[str, Metrics]) -> None:
        values = {key: {_text(run.get(key)) for run in runs.values()} for key in NAMES}
        same = {key: next(iter(found)) for key, found in values.items() if len(found) == 1 and key in IN_TITLE}
        self.shared = ", ".join(f"{key} {value}" for key, value in same.items() if value != UNKNOWN)
        self.differing = [key for key in values if len(values[key]) > 1]
        self.rows = list(_rows(runs))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the tables, with the runs' names where all of them fit, else with numbers."""
        from rich.text import Text

        if self.shared:
            yield Text(self.shared)
        tables = {
            title: [column for column in columns if any(column.of(row.run) is not None for row in self.rows)]
            for title, columns in TABLES.items()
        }
        tables = {title: columns for title, columns in tables.items() if columns}
        whole = [self._table(title, columns, named=True) for title, columns in tables.items()]
        if all(_width(table, console) <= options.max_width for table in whole):
            for table in whole:
                yield ""
                yield table
            return
        if len(self.rows) > 1:
            yield ""
            yield self._names(console, options.max_width)
        for title, columns in tables.items():
            yield from self._in_pieces(title, columns, console, options.max_width)

    def _in_pieces(self, title: str, columns: Sequence[Column], console: Console, width: int) -> Iterator[Table | str]:
        """Yield the columns in as many tables as they need, about equally long."""

        def fits(count: int) -> bool:
            parts = (columns[start : start + count] for start in range(0, len(columns), count))
            return all(_width(self._table(title, part, named=False), console) <= width for part in parts)

        most = next((count for count in range(len(columns), 1, -1) if fits(count)), 1)
        pieces = -(-len(columns) // most)
        each = -(-len(columns) // pieces)
        for start in range(0, len(columns), each):
            yield ""
            yield self._table("" if start else title, columns[start : start + each], named=False)

    def _table(self, title: str, columns: Sequence[Column], *, named: bool) -> Table:
        """Return one table; named: with the runs' names and settings, else with their numbers."""
        table = _empty(title)
        table.add_column("run", no_wrap=True, vertical="bottom")
        for key in self.differing if named else ():
            table.add_column(key, justify=_justify(key), no_wrap=True, vertical="bottom")
        for column in columns:
            table.add_column(column.title, justify="right", no_wrap=True)
        for row in self.rows:
            label = row.name if named or row.number is None or len(self.rows) == 1 else str(row.number)
            about = [_text(row.run.get(key)) for key in self.differing if named and row.values is None]
            about += [""] * (len(self.differing) * named - len(about))
            figures = (row.cell(column) for column in columns)
            table.add_row(label, *about, *figures, style="bold" if row.values else None, end_section=row.ends_group)
        return table

    def _names(self, console: Console, width: int) -> Table:
        """Return what each number stands for; names are as wide as the settings leave room for."""
        room = width - _width(self._names_table(lambda _: ""), console)
        return self._names_table(lambda name: _broken(name, room))

    def _names_table(self, shown: Callable[[str], str]) -> Table:
        table = _empty("Runs")
        table.add_column("run", justify="right")
        table.add_column("", no_wrap=True)
        for key in self.differing:
            table.add_column(key, justify=_justify(key))
        for row in self.rows:
            if row.values is None:
                table.add_row(str(row.number), shown(row.name), *(_text(row.run.get(key)) for key in self.differing))
        return table


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

    number = 0
    for _, group in groupby(sorted(runs.items(), key=kind), key=kind):
        members = list(group)
        for place, (name, run) in enumerate(members, 1):
            number += 1
            yield Row(name, number, run, ends_group=place == len(members))
        if len(members) > 1:
            for name, values in summaries([run for _, run in members]).items():
                yield Row(name, None, {}, values, ends_group=name == "worst")


def _empty(title: str) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    return Table(
        title=title or None,
        title_justify="left",
        box=SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        collapse_padding=True,
    )


def _width(table: Table, console: Console) -> int:
    from rich.measure import Measurement

    options = console.options.update(width=10_000)
    return Measurement.get(console, options, table).maximum


def _justify(key: str) -> Any:
    return "right" if key in ("particles", "seed") else "left"


def _broken(name: str, width: int) -> str:
    """Return a path in lines of this width, broken after slashes."""
    lines = [""]
    for part in name.replace("/", "/\n").split("\n"):
        if lines[-1] and len(lines[-1]) + len(part) > width:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)


def _text(value: object) -> str:
    return UNKNOWN if value is None else str(value)
