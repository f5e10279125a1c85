"""Print what a batch came to: a row for each log and choice with median and worst over seeds, failures, comparisons."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from localiser.batch.against import Verdict
from localiser.evaluate import ALL_LOGS, Comparison
from localiser.storage import CHOICE

if TYPE_CHECKING:
    from rich.table import Table

Row = Mapping[str, Any]
UNKNOWN = "–"


class Column(NamedTuple):
    """A figure of the table: title, name in the row, how it is written, its factor, which of several is the worst.

    worst: None where only the median is told.
    """

    title: str
    name: str
    spec: str
    factor: float = 1.0
    worst: Callable[[list[float]], float] | None = max


COLUMNS = (
    Column("RMSE\n(m)", "position_rmse_m", ".3f"),
    Column("head-\ning (°)", "heading_rmse_deg", ".2f"),
    Column("sure\n(%)", "confidence.sure", ".0f", 100.0, min),
    Column("sure,\nwrong\n(%)", "confidence.sure_and_wrong", ".1f", 100.0),
    Column("image\n(ms)", "frame_ms_median", ".0f", worst=None),
)


def summary_table(rows: Sequence[Row]) -> Table:
    """Return the table of a batch: the median over seeds, and the worst in brackets.

    Choices that are the same for all runs stand in the title; figures that no run knows are left out.
    """
    choices = [name for name in rows[0] if name == "config" or name.startswith(CHOICE)]
    varied = [name for name in choices if len({row[name] for row in rows}) > 1]
    same = [f"{_titled(name)} {rows[0][name]}" for name in choices if name not in varied and rows[0][name] is not None]
    columns = [column for column in COLUMNS if any(row.get(column.name) is not None for row in rows)]
    table = _table("\n".join(["Median over seeds (worst, where it differs)", *([", ".join(same)] if same else [])]))
    table.add_column("log", overflow="fold", vertical="bottom")
    for name in varied:
        table.add_column(_titled(name).replace(".", ".\n"), overflow="fold", vertical="bottom")
    table.add_column("runs", justify="right", vertical="bottom")
    for column in columns:
        table.add_column(column.title, justify="right", vertical="bottom", no_wrap=True)

    def group(row: Row) -> tuple[Any, ...]:
        return (row["log"], row["log_path"], *(row[name] for name in varied))

    for _, members in groupby(rows, key=group):
        runs = list(members)
        chosen = [UNKNOWN if runs[0][name] is None else str(runs[0][name]) for name in varied]
        table.add_row(str(runs[0]["log"]), *chosen, _count(runs), *(_over_seeds(runs, column) for column in columns))
    return table


def failures(rows: Sequence[Row]) -> list[str]:
    """Return a text for each run that failed, with its log, choices and reason."""
    return [f"{row['log']}{_choices(row)}: {row['error']}" for row in rows if row["error"]]


def comparison_table(verdict: Verdict) -> Table:
    """Return the table of the comparisons: those of all logs, then those of single logs that differ significantly."""
    table = _table("Compared with the other runs, in pairs of log and seed; all intervals hold together with 95 %")
    for title in ("figure", "log"):
        table.add_column(title, overflow="fold")
    table.add_column("pairs", justify="right")
    for title in ("change", "interval", ""):
        table.add_column(title, justify="right" if title == "change" else "left")
    for one in verdict.comparisons:
        if one.log == ALL_LOGS or one.is_worse or one.is_better or not _has_total(one, verdict.comparisons):
            told, style = ("worse", "bold red") if one.is_worse else ("better", "green") if one.is_better else ("", "")
            change, interval = _change(one)
            table.add_row(one.figure.title, one.log, str(one.pairs), change, interval, told, style=style)
    return table


def _has_total(one: Comparison, comparisons: Sequence[Comparison]) -> bool:
    return any(other.figure == one.figure and other.log == ALL_LOGS for other in comparisons)


def _change(one: Comparison) -> tuple[str, str]:
    """Return the mean change of a figure and its interval, in per cent; of shares, in percentage points."""
    if one.figure.as_ratio:
        mean, low, high = (_percent(value) for value in (one.loss, one.low, one.high))
        return f"{mean} %", f"{low} … {high} %"
    sign = 100.0 if one.figure.more_is_worse else -100.0
    least, middle, most = sorted(sign * value + 0.0 for value in (one.low, one.loss, one.high))  # no -0.0
    return f"{middle:+.1f} points", f"{least:+.1f} … {most:+.1f} points"


def _percent(logarithm: float) -> str:
    """Return the logarithm of a ratio as a change in per cent; one of more than a millionfold as such."""
    return f"{100 * math.expm1(logarithm):+.1f}" if logarithm < math.log(1e6) else "> 10⁸"


def _table(title: str) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    return Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)


def _count(runs: Sequence[Row]) -> str:
    failed = sum(run["error"] is not None for run in runs)
    return f"{len(runs)}, {failed} failed" if failed else str(len(runs))


def _over_seeds(runs: Sequence[Row], column: Column) -> str:
    known = [column.factor * float(run[column.name]) for run in runs if run.get(column.name) is not None]
    if not known:
        return UNKNOWN
    median = format(float(np.median(known)), column.spec)
    worst = median if column.worst is None else format(column.worst(known), column.spec)
    return median if worst == median else f"{median} ({worst})"


def _titled(name: str) -> str:
    return name.removeprefix(CHOICE)


def _choices(row: Row) -> str:
    names = [name for name in row if name.startswith(CHOICE) or name in ("config", "seed")]
    told = [f"{_titled(name)} {row[name]}" for name in names if row[name] is not None]
    return f" ({', '.join(told)})" if told else ""
