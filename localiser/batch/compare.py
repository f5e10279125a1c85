"""The tables of a batch, and its comparison with an earlier one: is a figure worse than chance explains?

Errors are compared by their ratio, shares by their difference, so that positive is always worse: for each log over its
seeds, and for all logs together over the logs' means, because runs of one log are not independent of each other.
Differences are taken as normal with unknown variance (Student's t). Holm's procedure corrects for the number of
comparisons: the probability of any false alarm among all of them is at most 5 % [Holm 1979].
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from localiser.errors import InputError
from localiser.evaluate import DECIMALS, Column, new_table
from localiser.geometry import Array
from localiser.storage import CHOICE, read_runs

if TYPE_CHECKING:
    from rich.table import Table

CSV = "runs.csv"
ALPHA = 0.05
ALL_LOGS = "all logs"

Row = Mapping[str, Any]
Pair = tuple[Row, Row]

# -- a row for each log and choice, with median and worst over seeds --------------------------------------------------

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


def summary_table(rows: Sequence[Row]) -> Table:
    """Return the table of a batch: the median over seeds of each log and choice, and the worst in brackets.

    What was chosen alike for all runs is in the title; figures that no run knows are left out.
    """
    choices = [name for name in rows[0] if name == "config" or name.startswith(CHOICE)]
    varied = [name for name in choices if len({row[name] for row in rows}) > 1]
    same = [f"{_titled(name)} {rows[0][name]}" for name in choices if name not in varied and rows[0][name] is not None]
    known = [column for column in COLUMNS if any(column.is_known(column.of(row)) for row in rows)]
    title = "\n".join(["Median over seeds (worst, where it differs)", *filter(None, [", ".join(same)])])
    chosen = [_titled(name).replace(".", ".\n") for name in varied]
    table = new_table(title, "log", *chosen, "runs", *(column.title for column in known), texts=1 + len(varied))

    def group(row: Row) -> tuple[Any, ...]:
        return (row["log"], row["log_path"], *(row[name] for name in varied))

    for _, members in groupby(rows, key=group):
        runs = list(members)
        values = [UNKNOWN if runs[0][name] is None else str(runs[0][name]) for name in varied]
        failed = sum(run["error"] is not None for run in runs)
        count = f"{len(runs)}, {failed} failed" if failed else str(len(runs))
        table.add_row(str(runs[0]["log"]), *values, count, *(_over_seeds(runs, column) for column in known))
    return table


def failures(rows: Sequence[Row]) -> list[str]:
    """Return a text for each run that failed, with its log, choices and reason."""
    texts = []
    for row in rows:
        names = [name for name in row if name.startswith(CHOICE) or name in ("config", "seed")]
        chosen = ", ".join(f"{_titled(name)} {row[name]}" for name in names if row[name] is not None)
        texts.append(f"{row['log']}{f' ({chosen})' if chosen else ''}: {row['error']}")
    return [text for text, row in zip(texts, rows, strict=True) if row["error"]]


def _over_seeds(runs: Sequence[Row], column: Column) -> str:
    known = [value for run in runs if (value := column.of(run)) is not None]
    if not known:
        return column.text(None)
    median, worst = column.text(float(np.median(known))), column.text(column.worst(known))
    return median if worst == median or column.key == "frame_ms_median" else f"{median} ({worst})"


def _titled(name: str) -> str:
    return name.removeprefix(CHOICE)


# -- comparisons -------------------------------------------------------------------------------------------------------


class Compared(NamedTuple):
    """A figure that is compared: its name in the row, its title, whether as a ratio, whether more is worse."""

    name: str
    title: str
    as_ratio: bool
    more_is_worse: bool = True


COMPARED = (
    Compared("position_rmse_m", "position RMSE", as_ratio=True),
    Compared("heading_rmse_deg", "heading RMSE", as_ratio=True),
    Compared("confidence.not_found", "not found yet", as_ratio=False),
    Compared("confidence.sure", "images sure", as_ratio=False, more_is_worse=False),
    Compared("confidence.sure_and_wrong", "sure and wrong", as_ratio=False),
)


@dataclass(frozen=True, slots=True)
class Comparison:
    """How much worse a figure is here than there, over P pairs.

    log: its name, or `ALL_LOGS`. loss: the mean over pairs, as the logarithm of the ratio or as a difference; positive
    is worse. low, high: its interval, corrected so that all intervals hold together with 95 %. p: the probability of
    such a difference by chance, corrected likewise.
    """

    figure: Compared
    log: str
    pairs: int
    loss: float
    low: float
    high: float
    p: float

    @property
    def is_worse(self) -> bool:
        """Whether it is significantly worse here."""
        return self.p <= ALPHA and self.loss > 0

    @property
    def is_better(self) -> bool:
        """Whether it is significantly better here."""
        return self.p <= ALPHA and self.loss < 0


def compare_pairs(pairs: Sequence[Pair], figures: Iterable[Compared] = COMPARED) -> list[Comparison]:
    """Return all comparisons of pairs (here, there), by figure, those of all logs first.

    A figure that is known in fewer than two pairs of a log, or two logs, is not compared for that log, or for all.
    """
    from scipy.special import stdtrit

    found: list[tuple[Compared, str, Array]] = []
    names = _names(pairs)
    for figure in figures:
        losses = _by_log(pairs, figure)
        if len(losses) > 1:
            found.append((figure, ALL_LOGS, np.array([np.mean(values) for values in losses.values()])))
        found += [(figure, names[log], np.array(values)) for log, values in losses.items() if len(values) > 1]
    error, p = np.array([_t_test(losses) for _, _, losses in found]).reshape(-1, 2).T
    adjusted, level = holm(p)
    pairs_of, mean = (np.array([of(losses) for _, _, losses in found]) for of in (len, np.mean))
    half = stdtrit(pairs_of - 1, 1 - level / 2) * error
    columns = np.stack([mean, mean - half, mean + half, adjusted], axis=-1).tolist()
    return [
        Comparison(figure, log, len(losses), *cells)
        for (figure, log, losses), cells in zip(found, columns, strict=True)
    ]


def holm(p: Array) -> tuple[Array, Array]:
    """Return the adjusted p-values (M,) of M tests, and the level (M,) of an interval that agrees with each.

    The smallest p is compared with alpha / M, the next with alpha / (M - 1), …, until the first that is larger; that
    one and all after it are not significant. An interval at probability 1 - level leaves 0 out just where Holm's
    procedure finds a difference.
    """
    count, order = len(p), np.argsort(p, kind="stable")
    weighted = p[order] * (count - np.arange(count))
    adjusted, level = np.empty(count), np.empty(count)
    adjusted[order] = np.minimum(np.maximum.accumulate(weighted), 1.0)
    kept = np.flatnonzero(weighted > ALPHA)
    last = kept[0] if kept.size else count
    level[order] = ALPHA / (count - np.minimum(np.arange(count), last))
    return adjusted, level


def _by_log(pairs: Sequence[Pair], figure: Compared) -> dict[str, list[float]]:
    losses: dict[str, list[float]] = {}
    least = 10.0**-DECIMALS  # figures are rounded to it
    for pair in pairs:
        if all(row.get(figure.name) is not None for row in pair):
            here, there = (float(row[figure.name]) for row in pair)
            loss = math.log(max(here, least) / max(there, least)) if figure.as_ratio else here - there
            losses.setdefault(str(pair[0]["log_id"]), []).append(loss if figure.more_is_worse else -loss)
    return losses


def _names(pairs: Sequence[Pair]) -> dict[str, str]:
    """Return what the logs are called, by `log_id`: their names, with the beginning of the id where two share one."""
    names = {str(here["log_id"]): str(here["log"]) for here, _ in pairs}
    shared = {name for name, count in Counter(names.values()).items() if count > 1}
    return {log_id: f"{name} {log_id[:6]}" if name in shared else name for log_id, name in names.items()}


def _t_test(losses: Array) -> tuple[float, float]:
    """Return the standard error of the mean, and the two-sided p-value of a mean of 0 by Student's t-test."""
    from scipy.special import stdtr

    mean = float(losses.mean())
    error = float(losses.std(ddof=1) / math.sqrt(len(losses))) if np.ptp(losses) > 0 else 0.0
    return error, float(2 * stdtr(len(losses) - 1, -abs(mean) / error)) if error else float(mean == 0)


# -- two batches ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a comparison came to.

    newly_failed: rows of runs that fail here and did not there. pairs: how many were compared. alone, alone_there: how
    many runs have no counterpart.
    """

    comparisons: Sequence[Comparison]
    newly_failed: Sequence[Row]
    pairs: int
    alone: int
    alone_there: int

    @property
    def is_loss(self) -> bool:
        """Whether something is significantly worse, or fails that did not."""
        return bool(self.newly_failed) or any(one.is_worse for one in self.comparisons)


def read_table_of(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a batch by its folder or its table. Raises InputError."""
    if path.is_dir() and not (path / CSV).is_file():
        raise InputError(f"expected the folder of a batch, with a {CSV}", path=path)
    return read_runs(path / CSV if path.is_dir() else path)


def compare_with(here: Sequence[Row], there: Sequence[Row], path: Path) -> Verdict:
    """Compare the rows of a batch with those read from `path`, which errors name.

    Pairs have the same measurements (`log_id`) and seed, and the same value of every setting (or configuration) that
    was varied on one side and has a value in common with the other. Raises InputError when runs there cannot be told
    apart, or none has a counterpart.
    """
    # Choices that have several values in either table, and one in common.
    choices = [name for name in here[0] if name == "config" or name.startswith(CHOICE)]
    values = {name: ({row.get(name) for row in here}, {row.get(name) for row in there}) for name in choices}
    varied = [name for name, (ours, theirs) in values.items() if max(len(ours), len(theirs)) > 1 and ours & theirs]
    names = ["log_id", "seed", *varied]
    ours, theirs = (_by_key(rows, names, path) for rows in (here, there))
    common = [key for key in ours if key in theirs]
    pairs = [(ours[key], theirs[key]) for key in common]
    if not pairs:
        raise InputError("expected runs of the same logs (by content) with the same seeds, found none", path=path)
    return Verdict(
        compare_pairs([pair for pair in pairs if not any(row.get("error") for row in pair)]),
        [row for row, other in pairs if row.get("error") and not other.get("error")],
        len(pairs),
        len(ours) - len(pairs),
        len(theirs) - len(pairs),
    )


def _by_key(rows: Sequence[Row], names: Sequence[str], path: Path) -> dict[tuple[Any, ...], Row]:
    found: dict[tuple[Any, ...], Row] = {}
    for row in rows:
        key = tuple(row.get(name) for name in names)
        if row.get("log_id") is None:
            continue  # of a log that could not be read
        if key in found:
            told = ", ".join(f"{name} {value}" for name, value in zip(names, key, strict=True))
            problem = f"expected one run for each log and seed on either side, found two with {told}"
            raise InputError(f"{problem}; compare fewer settings at once", path=path)
        found[key] = row
    return found


# -- the table --------------------------------------------------------------------------------------------------------


def comparison_table(verdict: Verdict) -> Table:
    """Return the table of the comparisons: those of all logs, then those of single logs that differ significantly."""
    title = "Compared with the other runs, in pairs of log and seed; all intervals hold together with 95 %"
    table = new_table(title, "figure", "log", "pairs", "change", "interval", "", texts=2)
    for one in verdict.comparisons:
        has_total = any(other.figure == one.figure and other.log == ALL_LOGS for other in verdict.comparisons)
        if one.log == ALL_LOGS or one.is_worse or one.is_better or not has_total:
            told, style = ("worse", "bold red") if one.is_worse else ("better", "green") if one.is_better else ("", "")
            change, interval = _change(one)
            table.add_row(one.figure.title, one.log, str(one.pairs), change, interval, told, style=style)
    return table


def _change(one: Comparison) -> tuple[str, str]:
    """Return the mean change of a figure and its interval, in per cent; of shares, in percentage points."""
    if one.figure.as_ratio:
        logs, most = (one.loss, one.low, one.high), math.log(1e6)
        mean, low, high = (f"{100 * math.expm1(log):+.1f}" if log < most else "> 10⁸" for log in logs)
        return f"{mean} %", f"{low} … {high} %"
    sign = 100.0 if one.figure.more_is_worse else -100.0
    least, middle, most = sorted(sign * value + 0.0 for value in (one.low, one.loss, one.high))  # no -0.0
    return f"{middle:+.1f} points", f"{least:+.1f} … {most:+.1f} points"
