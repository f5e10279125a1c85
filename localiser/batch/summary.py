"""What a batch came to: a row for each log and choice, with median and worst over seeds, and what failed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from localiser.evaluate import Column, new_table
from localiser.storage import CHOICE

if TYPE_CHECKING:
    from rich.table import Table

Row = Mapping[str, Any]
UNKNOWN = "–"


COLUMNS = (
    Column("RMSE\n(m)", "position_rmse_m", ".3f"),
    Column("head-\ning (°)", "heading_rmse_deg", ".2f"),
    Column("not\nfound\n(%)", "confidence.not_found", ".0f", per=100.0, is_told_at_0=False),
    Column("sure\n(%)", "confidence.sure", ".0f", per=100.0, worst=min),
    Column("sure,\nwrong\n(%)", "confidence.sure_and_wrong", ".1f", per=100.0),
    Column("image\n(ms)", "frame_ms_median", ".0f"),
)
"""Of the table in the terminal: few enough for 80 characters. "-" ends a divided word."""
WRITTEN = (Column("odometry alone (m)", "odometry_position_rmse_m", ".3f"), *COLUMNS[:-1])
"""Of the table as Markdown: with what the wheels alone do, without times, which differ from run to run."""
MEDIAN_ALONE = ("frame_ms_median", "odometry_position_rmse_m")
"""Figures of which the worst over seeds says nothing."""


class Summary(NamedTuple):
    """The cells of a batch's table. same: what was chosen alike for all runs. titles, rows: of its columns.

    The columns are the log, as many `choices` as were varied, the number of runs, and the figures.
    """

    same: str
    titles: list[str]
    choices: int
    rows: list[list[str]]


def summary_of(rows: Sequence[Row], columns: Sequence[Column] = COLUMNS) -> Summary:
    """Return the median over seeds of each log and choice, and the worst in brackets.

    Figures that no run knows are left out.
    """
    choices = [name for name in rows[0] if name == "config" or name.startswith(CHOICE)]
    varied = [name for name in choices if len({row[name] for row in rows}) > 1]
    same = [f"{_titled(name)} {rows[0][name]}" for name in choices if name not in varied and rows[0][name] is not None]
    known = [column for column in columns if any(column.is_known(column.of(row)) for row in rows)]

    def group(row: Row) -> tuple[Any, ...]:
        return (row["log"], row["log_path"], *(row[name] for name in varied))

    cells = []
    for _, members in groupby(rows, key=group):
        runs = list(members)
        chosen = [UNKNOWN if runs[0][name] is None else str(runs[0][name]) for name in varied]
        cells.append([str(runs[0]["log"]), *chosen, _count(runs), *(_over_seeds(runs, column) for column in known)])
    titles = ["log", *(_titled(name) for name in varied), "runs", *(column.title for column in known)]
    return Summary(", ".join(same), titles, len(varied), cells)


def summary_table(rows: Sequence[Row]) -> Table:
    """Return the table of a batch for a terminal; see `summary_of`."""
    summary = summary_of(rows)
    title = "\n".join(["Median over seeds (worst, where it differs)", *filter(None, [summary.same])])
    told = 1 + summary.choices
    titles = [name.replace(".", ".\n") for name in summary.titles[:told]]
    table = new_table(title, *titles, *summary.titles[told:], texts=told)
    for cells in summary.rows:
        table.add_row(*cells)
    return table


def summary_markdown(rows: Sequence[Row]) -> str:
    """Return the table of a batch as Markdown; the same batch writes the same bytes."""
    summary = summary_of(rows, WRITTEN)
    titles = [title.replace("-\n", "").replace("\n", " ") for title in summary.titles]
    told = 1 + summary.choices
    rule = [*(["---"] * told), *(["--:"] * (len(titles) - told))]
    lines = [_markdown_row(cells) for cells in (titles, rule, *summary.rows)]
    same = [f"All runs: {summary.same}.", ""] if summary.same else []
    return "\n".join([*same, *lines]) + "\n"


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"


def failures(rows: Sequence[Row]) -> list[str]:
    """Return a text for each run that failed, with its log, choices and reason."""
    return [f"{row['log']}{_choices(row)}: {row['error']}" for row in rows if row["error"]]


def _count(runs: Sequence[Row]) -> str:
    failed = sum(run["error"] is not None for run in runs)
    return f"{len(runs)}, {failed} failed" if failed else str(len(runs))


def _over_seeds(runs: Sequence[Row], column: Column) -> str:
    known = [value for run in runs if (value := column.of(run)) is not None]
    if not known:
        return column.text(None)
    median, worst = column.text(float(np.median(known))), column.text(column.worst(known))
    return median if worst == median or column.key in MEDIAN_ALONE else f"{median} ({worst})"


def _titled(name: str) -> str:
    return name.removeprefix(CHOICE)


def _choices(row: Row) -> str:
    names = [name for name in row if name.startswith(CHOICE) or name in ("config", "seed")]
    told = [f"{_titled(name)} {row[name]}" for name in names if row[name] is not None]
    return f" ({', '.join(told)})" if told else ""
