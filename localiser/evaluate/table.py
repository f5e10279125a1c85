"""The errors of one run or several as a table for the terminal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from rich.table import Table

Metrics = Mapping[str, Any]


class Column(NamedTuple):
    """A figure of the table: its title, its key in the metrics, how it is written, which of several is the worst."""

    title: str
    key: str
    spec: str
    worst: Callable[[list[float]], float] = max


# In the order of reading: how good, how bad, how sure of itself, how close to the limit.
COLUMNS = (
    Column("RMSE\n(m)", "position_rmse_m", ".3f"),
    Column("median\n(m)", "position_median_m", ".3f"),
    Column("max\n(m)", "position_max_m", ".3f"),
    Column("end\n(m)", "position_end_m", ".3f"),
    Column("heading\n(°)", "heading_rmse_deg", ".2f"),
    Column("odometry\n(m)", "odometry_position_rmse_m", ".3f"),
    Column("NEES", "nees_mean", ".1f"),
    Column("efficiency", "efficiency", ".2f"),
    Column("edges", "edges_per_frame", ".1f", min),
)
UNKNOWN = "–"


def errors_table(runs: Mapping[str, Metrics]) -> Table:
    """Return the table of named runs' metrics; where several share log and observation, their median and worst too."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title="Errors against the truth, no alignment", title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for title in ("run", "log", "observation", "seed"):
        table.add_column(title, justify="right" if title == "seed" else "left", overflow="fold", vertical="bottom")
    for column in COLUMNS:
        table.add_column(column.title, justify="right", no_wrap=True)

    ordered = sorted(runs.items(), key=lambda run: _kind(run[1]))
    for _, group in groupby(ordered, key=lambda run: _kind(run[1])):
        members = list(group)
        for name, run in members:
            table.add_row(name, *(_text(run.get(key)) for key in ("log", "observation", "seed")), *_figures(run))
        if len(members) > 1:
            table.add_section()
            for title, summary in summaries([run for _, run in members]).items():
                table.add_row(title, "", "", "", *_figures(summary), style="bold")
        table.add_section()
    return table


def summaries(runs: list[Metrics]) -> dict[str, dict[str, float | None]]:
    """Return the median and the worst of each column over the runs that know it."""
    median: dict[str, float | None] = {}
    worst: dict[str, float | None] = {}
    for column in COLUMNS:
        known = [float(run[column.key]) for run in runs if run.get(column.key) is not None]
        median[column.key] = float(np.median(known)) if known else None
        worst[column.key] = column.worst(known) if known else None
    return {"median": median, "worst": worst}


def _kind(run: Metrics) -> tuple[str, str]:
    return _text(run.get("log")), _text(run.get("observation"))


def _figures(run: Metrics) -> list[str]:
    return [UNKNOWN if run.get(column.key) is None else format(run[column.key], column.spec) for column in COLUMNS]


def _text(value: object) -> str:
    return UNKNOWN if value is None else str(value)
