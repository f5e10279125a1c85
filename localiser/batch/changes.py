"""The table of what changed between two batches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from localiser.batch.against import Verdict
from localiser.batch.summary import plain_table
from localiser.evaluate import ALL_LOGS, Comparison

if TYPE_CHECKING:
    from rich.table import Table


def comparison_table(verdict: Verdict) -> Table:
    """Return the table of the comparisons: those of all logs, then those of single logs that differ significantly."""
    table = plain_table("Compared with the other runs, in pairs of log and seed; all intervals hold together with 95 %")
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
