"""How the outcomes of a scenario are summed up over seeds, and what is asked of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch

import numpy as np
from belief_scenarios import Case, Outcome
from intervals import rate_bound
from rich.table import Table


@dataclass(frozen=True, slots=True)
class Column:
    """A figure of a scenario's table.

    values: named in `Values`. over: how seeds are summed up. digits: of the figure as shown. percent: whether it is a
    share. bars: limits by pattern of the case's name, the first that fits; at_least: whether they are lower limits.
    """

    values: str
    over: str
    digits: int = 2
    percent: bool = False
    bars: tuple[tuple[str, float], ...] = ()
    at_least: bool = False

    @property
    def title(self) -> str:
        """What stands above it."""
        return f"{self.values}, {self.over}"

    def bar(self, case: Case) -> float | None:
        """Return what is asked of a case, None where nothing is."""
        return next((limit for pattern, limit in self.bars if fnmatch(case.name, pattern)), None)

    def figure(self, outcomes: Sequence[Outcome]) -> float:
        """Return the figure over the seeds of a case; infinite is never, nan nothing."""
        samples = np.array([one.values[self.values] for one in outcomes])
        samples = samples[~np.isnan(samples)]
        return OVER[self.over](samples) if len(samples) else math.nan

    def missed(self, case: Case, figure: float) -> bool:
        """Whether a figure is not what is asked."""
        bar = self.bar(case)
        return bar is not None and not (figure >= bar if self.at_least else figure <= bar)

    def shown(self, figure: float) -> str:
        """Return the figure for people."""
        if math.isnan(figure):
            return "–"
        if math.isinf(figure):
            return "never"
        return f"{100 * figure:.{self.digits}f} %" if self.percent else f"{figure:.{self.digits}f}"


RARE = ("false_recoveries", "hours", "images", "metres")


def _median(samples: np.ndarray) -> float:
    """Return the upper of the two middle ones, so that never counts."""
    return float(np.sort(samples)[len(samples) // 2])


OVER: dict[str, Callable[[np.ndarray], float]] = {
    "median": _median,
    "worst": lambda samples: float(samples.max()),
    "least": lambda samples: float(samples.min()),
    "mean": lambda samples: float(samples.mean()),
    "sum": lambda samples: float(samples.sum()),
}
_SCORE = Column("log_score", "mean", 3)
_WRONG = Column("sure_wrong", "mean", 2, True, (("*", 0.005),))
COLUMNS: dict[str, tuple[Column, ...]] = {
    "tracking": (
        Column("rmse_m", "median", 3),
        Column("rmse_m", "worst", 3, bars=(("bookstore truth line", 0.03), ("bookstore truth slope", 0.06))),
        Column("rmse_found_m", "worst", 3),
        Column("nees / 3", "median", 2),
        Column("sure", "mean", 1, True, (("house truth*", 0.90), ("corridor truth*", 0.95)), at_least=True),
        Column("sure_found", "mean", 1, True, (("bookstore*", 0.80), ("shop*", 0.80)), at_least=True),
        _WRONG,
        Column("found_s", "median", 1),
        Column("found_s", "worst", 1, bars=(("bookstore global*", 15.0), ("shop global*", 15.0))),
        Column("lost_images", "worst", 0, bars=(("*", 0.0),)),
        _SCORE,
    ),
    "wrong": (
        Column("sure_later", "mean", 1, True),
        Column("sure_later", "worst", 1, True, (("*", 0.01),)),
        Column("p_mean", "mean", 2),
        Column("p_max", "worst", 3),
        Column("warned_s", "median", 1),
        Column("warned_s", "worst", 1, bars=(("*", 20.0),)),
        Column("warned_images", "mean", 0, True),
        _SCORE,
    ),
    "right": (
        Column("warned_s", "least", 1, bars=(("*", math.inf),), at_least=True),
        Column("rmse_m", "median", 3),
        Column("rmse_m", "worst", 3),
        Column("sure", "mean", 1, True),
        _WRONG,
        Column("found_s", "worst", 1),
        Column("lost_images", "worst", 0),
        _SCORE,
    ),
    "recovery": (
        Column("hours", "sum", 2),
        Column("images", "sum", 0),
        Column("metres", "sum", 0),
        Column("false_recoveries", "sum", 0, bars=(("*", 0.0),)),
        Column("off", "mean", 2, True),
        Column("rmse_m", "median", 3),
        Column("rmse_m", "worst", 3),
        Column("edges", "mean", 1),
        Column("mapped", "mean", 1),
        Column("sure", "mean", 1, True),
        _WRONG,
        _SCORE,
    ),
    "kidnapped": (
        Column("back_images", "median", 0, bars=(("bookstore*", math.inf), ("*", 5.0))),
        Column("back_images", "worst", 0),
        Column("back_s", "worst", 1, bars=(("bookstore*", 15.0),)),
        Column("sure_images", "median", 0, bars=(("*", 2.0),)),
        Column("sure_images", "worst", 0, bars=(("*", 6.0),)),
        Column("noticed_images", "median", 0),
        Column("for_good", "mean", 0, True, (("bookstore*", 0.0), ("*", 0.99)), at_least=True),
        _SCORE,
    ),
    "misplaced": (
        Column("telling_images", "median", 0),
        Column("telling_images", "worst", 0, bars=(("*", 10.0),)),
        Column("images", "worst", 0),
        Column("sure_images", "median", 0),
        Column("sure_images", "worst", 0),
        Column("back_s", "median", 1),
        Column("back_s", "worst", 1),
        _SCORE,
    ),
    "mrclam": (
        Column("median_m", "median", 3, bars=(("1 *", 0.20), ("2 *", 0.12), ("3 *", 0.125))),
        Column("median_m", "worst", 3),
        Column("sure", "mean", 1, True),
        Column("sure_wrong", "mean", 2, True),
        Column("sure_wrong", "worst", 2, True, (("*", 0.005),)),
        _SCORE,
    ),
    "time": (
        Column("median_ms", "median", 2),
        Column("p99 / median", "worst", 2, bars=(("*", 3.0),)),
        Column("max / median", "worst", 2),
        Column("first / median", "worst", 1),
    ),
}


def table_of(scenario: str, outcomes: Sequence[Outcome]) -> Table:
    """Return the figures of a scenario, one row a case; red is what is not as asked."""
    table = Table("case", "seeds", title=scenario, title_justify="left")
    for column in COLUMNS[scenario]:
        table.add_column(column.title, justify="right")
    table.add_column("wall s", justify="right")
    for case in dict.fromkeys(one.case for one in outcomes):
        own = [one for one in outcomes if one.case == case]
        cells = []
        for column in COLUMNS[scenario]:
            figure = column.figure(own)
            text = column.shown(figure)
            cells.append(f"[red]{text} ![/red]" if column.missed(case, figure) else text)
        table.add_row(case.name, str(len(own)), *cells, f"{sum(one.wall_s for one in own):.0f}")
    return table


def figures_of(scenario: str, outcomes: Sequence[Outcome]) -> list[dict[str, object]]:
    """Return the figures of a scenario as plain data, one entry a case; None where nothing is, or never."""
    rows: list[dict[str, object]] = []
    for case in dict.fromkeys(one.case for one in outcomes):
        own = [one for one in outcomes if one.case == case]
        figures = {column.title: column.figure(own) for column in COLUMNS[scenario]}
        missed = [column.title for column in COLUMNS[scenario] if column.missed(case, column.figure(own))]
        plain = {name: finite(value) for name, value in figures.items()}
        rows.append({"scenario": scenario, "case": case.name, "seeds": len(own), "missed": missed, **plain})
    return rows


def rates_of(outcomes: Sequence[Outcome]) -> list[dict[str, object]]:
    """Return how rare false recoveries are, in each kind of world and in all, with one-sided 95 % bounds."""
    kinds = list(dict.fromkeys(one.case.about[0] for one in outcomes))
    rows: list[dict[str, object]] = []
    for kind in [*kinds, "all"]:
        own = [one for one in outcomes if kind in (one.case.about[0], "all")]
        total = {name: sum(one.values[name] for one in own) for name in RARE}
        count = round(total.pop("false_recoveries"))
        bounds = {f"bound per {name.removesuffix('s')}": rate_bound(count, value) for name, value in total.items()}
        wall_h = sum(one.wall_s for one in own) / 3600
        rows.append({"world": kind, "count": count, **total, **bounds, "hours per hour": total["hours"] / wall_h})
    return rows


def rate_table(rows: Sequence[dict[str, object]]) -> Table:
    """Return the rates as a table."""
    table = Table(title="false recoveries, 95 % bounds of their rate", title_justify="left")
    for name in rows[0]:
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(*(value if isinstance(value, str) else f"{value:.5g}" for value in row.values()))
    return table


def finite(value: float) -> float | str | None:
    """Return the number as JSON can have it: "never" where it is infinite, None where it is nan."""
    if math.isnan(value):
        return None
    return "never" if math.isinf(value) else float(f"{value:.6g}")
