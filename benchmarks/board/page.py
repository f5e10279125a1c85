"""The page of the scoreboard: kept as JSON, printed as tables, and compared with another one."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
from scipy.stats import t as student

from board.run import FIGURES, NEVER, Values
from localiser.geometry import Array

Page = dict[str, dict[int, Values]]
"""Figures by the title of the row, `group: name`, and by seed."""
DIGITS = 5  # that are kept of a figure
HONEST_NEES = 3.0
SHARE, POINT, LARGE = 0.03, 0.01, 0.10
"""Least change of the median; of the median of a rate; of every seed by itself."""
ENOUGH = 5  # seeds that may say so by themselves
LONG = 1e4  # from where on a figure is printed by its power of ten
CALLED = 40  # figures, of which chance alone calls one worse


def seeds_of(text: str) -> list[int]:
    """Return the seeds that `0-4` or `3` stands for."""
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


# -- kept --------------------------------------------------------------------------------------------------------------


def rounded(values: Values) -> Values:
    """Return figures as they are kept, with five digits."""
    return {key: float(f"{one:.{DIGITS}g}") for key, one in values.items()}


def save(path: Path, page: Page) -> None:
    """Write a page: a line for each run; null for never."""
    runs = []
    for title, row in page.items():
        group, _, name = title.partition(": ")
        for seed, values in row.items():
            kept = {key: None if one == NEVER else one for key, one in values.items()}
            runs.append(json.dumps({"group": group, "row": name, "seed": seed} | kept, ensure_ascii=False))
    path.write_text("[\n" + ",\n".join(runs) + "\n]\n", encoding="utf-8")


def load(path: Path) -> Page:
    """Return a page that was saved."""
    page: Page = {}
    for run in json.loads(path.read_text(encoding="utf-8")):
        title, seed = f"{run.pop('group')}: {run.pop('row')}", run.pop("seed")
        page.setdefault(title, {})[seed] = {key: NEVER if one is None else one for key, one in run.items()}
    return page


# -- printed -----------------------------------------------------------------------------------------------------------


def markdown(page: Page) -> str:
    """Return the page as a document: how it is made, what the figures mean, and the tables."""
    seeds = sorted({seed for row in page.values() for seed in row})
    lines = [
        "# Scoreboard",
        "",
        f"{len(page)} situations, seeds {seeds[0]} to {seeds[-1]}, by `python benchmarks/scoreboard.py`;",
        "[CONTRIBUTING.md](../CONTRIBUTING.md) says how it is used. Each figure is the median of the seeds, with the",
        "worst in brackets where that differs, or how many seeds never came to a value.",
        "",
    ]
    keys = {key for row in page.values() for values in row.values() for key in values}
    lines += [f"- *{one.title}*: {one.meaning}" for key, one in FIGURES.items() if key in keys and one.is_shown]
    return "\n".join(lines) + "\n\n" + tables(page)


def tables(page: Page) -> str:
    """Return a table for each group of rows, as Markdown. A column in which no run has a value is left out."""
    text = ""
    for group, titles in groupby(page, lambda title: title.partition(": ")[0]):
        rows = {title.partition(": ")[2]: list(page[title].values()) for title in titles}
        known = {key for runs in rows.values() for one in runs for key in one if one[key] != NEVER}
        keys = [key for key, figure in FIGURES.items() if key in known and figure.is_shown]
        text += f"| {group} | " + " | ".join(FIGURES[key].title for key in keys) + " |\n"
        text += "|---" * (len(keys) + 1) + "|\n"
        for name, runs in rows.items():
            cells = [cell(key, [one[key] for one in runs]) for key in keys]
            text += f"| {name} | " + " | ".join(cells) + " |\n"
        text += "\n"
    return text


def cell(key: str, values: Sequence[float]) -> str:
    """Return median and worst of some seeds, where that differs, and how many of them never came to a value."""
    shown = number(key, float(np.median(values)))
    never = sum(one == NEVER for one in values)
    if len(values) == 1 or never == len(values):
        return shown
    worst = f"{never} never" if never else number(key, values[int(badness(key, np.array(values)).argmax())])
    return shown if worst == shown else f"{shown} ({worst})"


def number(key: str, value: float) -> str:
    """Return a figure as it is printed."""
    if value == NEVER:
        return "never"
    if FIGURES[key].is_rate:
        return f"{100 * value:.1f}"
    return f"{value:.{FIGURES[key].digits}f}" if abs(value) < LONG else f"{value:.1e}"


# -- compared ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Compared:
    """A figure of a row: its median before and now, and whether it is `worse`, `better`, or neither (empty)."""

    title: str
    key: str
    before: float
    now: float
    verdict: str


def compared(before: Page, now: Page, exact: Collection[str] = ()) -> list[Compared]:
    """Return what became of every figure of every row that both pages have, by the seeds that both have.

    exact: titles of rows in which nothing is left to chance.
    """
    found = []
    for title, row in now.items():
        seeds = [seed for seed in row if seed in before.get(title, {})]
        for key in row[seeds[0]] if seeds else ():
            if all(key in before[title][seed] for seed in seeds):
                pairs = np.array([[before[title][seed][key], row[seed][key]] for seed in seeds])
                said = verdict(key, pairs, exact=title in exact) if FIGURES[key].is_judged else ""
                found.append(Compared(title, key, *map(float, np.median(pairs, axis=0)), said))
    return found


def verdict(key: str, pairs: Array, *, exact: bool = False) -> str:
    """Return whether a figure is `worse` or `better`, or neither, by pairs (S, 2) of its values before and now.

    exact: whether nothing is left to chance, so that one pair is enough.
    """
    figure, bad = FIGURES[key], badness(key, pairs)
    known = np.isfinite(bad)
    # Never is worse than any value that there is, however it is measured.
    bad = np.where(known, bad, 2.0 * np.abs(bad[known]).max(initial=figure.floor))
    change, size = bad[:, 1] - bad[:, 0], np.ones(len(bad)) if key == "nees" else np.abs(bad[:, 0])
    mean, middle = change.mean(), np.median(change)
    least = POINT if figure.is_rate else max(SHARE * np.median(size), figure.floor)
    is_beyond = exact or (len(change) > 1 and abs(mean) > half_width(change))
    is_worse = is_beyond and abs(middle) >= least and mean * middle > 0
    large = np.maximum(LARGE * size, figure.floor)
    every = len(change) >= ENOUGH and ((change >= large).all() or (change <= -large).all())
    return ("worse" if mean > 0 else "better") if is_worse or every else ""


def half_width(change: Array) -> float:
    """Return half of the 95 % interval (t) of the mean of changes (S,)."""
    return float(student.ppf(0.975, len(change) - 1) * change.std(ddof=1) / np.sqrt(len(change)))


def badness(key: str, values: Array) -> Array:
    """Return what grows as a figure gets worse. Of NEES, how far its logarithm is from that of an honest one."""
    if key == "nees":
        return np.abs(np.log(np.maximum(values, 1e-9) / HONEST_NEES))
    return -values if FIGURES[key].more_is_better else values


def comparison(found: Sequence[Compared], reference: str) -> str:
    """Return what is worse and what is better than the reference, as Markdown, and the ratio of times."""
    judged = [one for one in found if FIGURES[one.key].is_judged]
    count = len({one.title for one in found})
    lines = [
        f"Against {reference}: {len(judged)} figures of {count} rows. Chance alone calls about 1 in {CALLED} worse."
    ]
    for word in ("worse", "better"):
        chosen = [one for one in judged if one.verdict == word]
        lines += ["", f"{word}: {len(chosen)}"]
        for title, row in groupby(chosen, lambda one: one.title):
            parts = [
                f"{FIGURES[one.key].title} {number(one.key, one.before)} → {number(one.key, one.now)}" for one in row
            ]
            lines.append(f"- {title}: " + ", ".join(parts))
    times = [one.now / one.before for one in found if one.key == "ms" and one.before > 0]
    if times:
        lines += ["", f"processor time of an image, median of rows: {np.median(times):.2f} × that of before"]
    return "\n".join(lines)
