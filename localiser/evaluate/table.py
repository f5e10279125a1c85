"""Print the errors of one run or several as a table in the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from localiser.evaluate.metrics import ABOUT

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
    Column("head-\ning (°)", "heading_rmse_deg", ".2f"),
    Column("odome-\ntry (m)", "odometry_position_rmse_m", ".3f"),
    Column("NEES", "nees_mean", ".1f"),
    Column("effi-\nciency", "efficiency", ".2f"),
    Column("edges", "edges_per_frame", ".1f", min),
)
NAMES = ("log", *ABOUT)
IN_TITLE = tuple(name for name in NAMES if name != "inputs")  # a fingerprint says something only where it differs
UNKNOWN = "–"


def errors_table(runs: Mapping[str, Metrics]) -> Table:
    """Return the table of named runs' metrics; where several differ by their seed alone, their median and worst too.

    So that it fits a terminal, what is the same for all runs stands in the title, and figures that no run knows are
    left out.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    values = {key: {_text(run.get(key)) for run in runs.values()} for key in NAMES}
    same = {key: next(iter(found)) for key, found in values.items() if len(found) == 1 and key in IN_TITLE}
    shared = [f"{key} {value}" for key, value in same.items() if value != UNKNOWN]
    names = [key for key in values if len(values[key]) > 1]
    columns = [column for column in COLUMNS if any(run.get(column.key) is not None for run in runs.values())]

    title = f"Errors against the truth, no alignment\n{', '.join(shared)}".strip()
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("run", overflow="fold", vertical="bottom")
    for key in names:
        justify: Any = "right" if key in ("particles", "seed") else "left"
        table.add_column(key, justify=justify, overflow="fold", vertical="bottom")
    for column in columns:
        table.add_column(column.title, justify="right", no_wrap=True)

    def kind(run: tuple[str, Metrics]) -> tuple[str, ...]:
        return tuple(_text(run[1].get(key)) for key in NAMES if key != "seed")

    for _, group in groupby(sorted(runs.items(), key=kind), key=kind):
        members = list(group)
        for name, run in members:
            table.add_row(name, *(_text(run.get(key)) for key in names), *_figures(run, columns))
        if len(members) > 1:
            table.add_section()
            for title, summary in summaries([run for _, run in members]).items():
                table.add_row(title, *[""] * len(names), *_figures(summary, columns), style="bold")
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


def _figures(run: Metrics, columns: Iterable[Column]) -> list[str]:
    return [UNKNOWN if run.get(column.key) is None else format(run[column.key], column.spec) for column in columns]


def _text(value: object) -> str:
    return UNKNOWN if value is None else str(value)
