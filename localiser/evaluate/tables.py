"""Figures of runs as flat rows, and tables for the terminal: all look alike, columns that do not fit go on below.

No word is broken. The tables of runs tell what runs know of themselves, and their errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from localiser.evaluate.metrics import ABOUT

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

# -- flat rows --------------------------------------------------------------------------------------------------------


def figure_at(figures: Mapping[str, Any], name: str) -> Any:
    """Return the figure of that name, as `flat_figures` has it (`group.figure`), None where it is not there."""
    if name in figures:
        return figures[name]
    value: Any = figures
    for part in name.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def flat_figures(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return metrics as a row of numbers, truth values, texts and None, in the order that they have.

    Why images were not sure (`confidence.reasons`) is one text, `reason (images); …`, since its keys differ from run to
    run.
    """
    return dict(_flat(figures, ""))


def _flat(figures: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in figures.items():
        name = f"{prefix}{key}"
        if key == "reasons" and isinstance(value, Mapping):
            yield name, "; ".join(f"{reason} ({count})" for reason, count in value.items()) or None
        elif isinstance(value, Mapping):
            yield from _flat(value, f"{name}.")
        elif isinstance(value, list):
            texts = [one for one in value if isinstance(one, str)]
            yield name, " ".join(texts) or None if texts or key == "warnings" else len(value)
        else:
            yield name, value


# Name in `biases`: how it reads, unit, and what the value is multiplied by for it.
LEARNT = {
    "distance_scale": ("distance", "%", 100.0),
    "turn_scale": ("turn", "%", 100.0),
    "veer": ("veer", "°/m", 57.29577951308232),
    "camera_yaw": ("camera yaw", "°", 57.29577951308232),
    "delay": ("delay", "ms", 1000.0),
}


def learnt_constants(figures: Mapping[str, Any]) -> list[str]:
    """Return a text for each constant error that the run has learnt, and for tilt and roll by the edges."""
    texts = []
    for name, learnt in (figures.get("biases") or {}).items():
        label, unit, per = LEARNT.get(name, (name.replace("_", " "), "", 1.0))
        space = "" if unit.startswith("°") else " "
        texts.append(f"{label} {per * learnt['value']:+.2f} ± {per * learnt['sigma']:.2f}{space}{unit}".rstrip())
    for name in ("tilt", "roll"):
        if figures.get(f"{name}_found_deg") is not None:
            found, sigma = figures[f"{name}_found_deg"], figures[f"{name}_found_sigma_deg"]
            texts.append(f"{name} {found:.3f} ± {sigma:.3f}°")
    return texts


# -- tables -----------------------------------------------------------------------------------------------------------

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

    Each piece begins with the columns that tell the rows apart. The title stands once. A table without a header is
    a list of texts, whose lines are wrapped instead.
    """
    if not table.show_header or _width(table, console) <= console.width:
        return [table]
    count, cells = len(table.columns), [[str(cell) for cell in column.cells] for column in table.columns]
    # As many columns at the beginning as tell the rows apart.
    keys = next((k for k in range(1, count) if len(set(zip(*cells[:k], strict=True))) == len(table.rows)), 1)
    pieces: list[Table] = []
    start = keys
    while start < count:
        end = count
        while end > start + 1 and _width(_part(table, keys, start, end), console) > console.width:
            end -= 1
        pieces.append(_part(table, keys, start, end))
        start = end
    pieces = pieces or [table]
    pieces[0].title = table.title
    return pieces


def _part(table: Table, keys: int, start: int, end: int) -> Table:
    """Return a table of its first columns, `keys` of them, and those from `start` to `end`, without a title."""
    part = copy(table)
    part.title = None
    chosen = [*table.columns[:keys], *table.columns[start:end]]
    part.columns = [replace(column, _index=place) for place, column in enumerate(chosen)]
    return part


def _width(table: Table, console: Console) -> int:
    """Return the width of the columns, which that of the title does not change."""
    from rich.measure import Measurement

    return Measurement.get(console, console.options.update(width=10_000), table).maximum


# -- the tables of runs -----------------------------------------------------------------------------------------------


class Column(NamedTuple):
    """A figure: its title in a table, its key in the metrics (dots for groups), how it is written, how it reads.

    label, unit: of it alone, where a page shows it. worst: which of several is the worst, in a batch. per: what it
    is multiplied by. is_told_at_0: False for one that is left out where it is 0 in all runs.
    """

    title: str
    key: str
    spec: str
    label: str = ""
    unit: str = ""
    worst: Callable[[list[float]], float] = max
    per: float = 1.0
    is_told_at_0: bool = True

    def is_known(self, value: Value) -> bool:
        """Whether a figure is worth a place."""
        return value is not None and (self.is_told_at_0 or value != 0)

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
    Column("found\n(s)", "confidence.found_s", ".1f", "found after", " s"),
    Column("not found\nyet (%)", "confidence.not_found", ".1f", "not found yet", " %", per=100.0, is_told_at_0=False),
    Column("sure\n(%)", "confidence.sure", ".1f", "images sure", " %", per=100.0),
    Column("match\n(%)", "edges_matched", ".0f", "edges matched", " %", per=100.0),
    Column("resid.\nχ²", "residuals.consistency", ".2f", "residuals (right: 1, below: cautious)"),
    Column("3σ\n(m)", "position_3sigma_median_m", ".3f", "3σ, median", " m"),
    Column("worst\n(m)", "position_3sigma_max_m", ".3f", "3σ, worst", " m"),
    Column("3σ\n(°)", "heading_3sigma_median_deg", ".2f", "3σ of heading", "°"),
    Column("drive\n(m)", "distance_m", ".1f", "distance", " m"),
    Column("speed\n(m/s)", "speed_mean_m_s", ".2f", "mean speed", " m/s"),
    Column("gaps", "pauses", ".0f"),
    Column("image\n(ms)", "frame_ms_median", ".0f", "time an image", " ms"),
)
# How good, how bad, how sure of itself.
ERRORS = (
    Column("RMSE\n(m)", "position_rmse_m", ".3f", "position RMSE", " m"),
    Column("median\n(m)", "position_median_m", ".3f", "position median", " m"),
    Column("max\n(m)", "position_max_m", ".3f", "position maximum", " m"),
    Column("end\n(m)", "position_end_m", ".3f"),
    Column("heading\n(°)", "heading_rmse_deg", ".2f", "heading RMSE", "°"),
    Column("odom.\n(m)", "odometry_position_rmse_m", ".3f", "odometry alone", " m"),
    Column("wrong\n(%)", "confidence.sure_and_wrong", ".1f", "sure and wrong", " %", per=100.0),
    Column("NEES", "nees_mean", ".1f", "NEES (right: 3, below: cautious)"),
)
NOTES = {"resid.\nχ²": "resid. χ²: 1 is right, below: cautious", "NEES": "NEES: 3 is right, below: cautious"}
"""What stands below a table with these columns."""
TABLES = {"What the run knows of itself": OWN, "Errors against the truth": ERRORS}
COLUMNS = (*OWN, *ERRORS)
NAMES = ("log", *ABOUT)
IN_TITLE = tuple(name for name in NAMES if name != "inputs")  # a fingerprint says something only where it differs
UNKNOWN = "–"


def run_tables(runs: Mapping[str, Metrics]) -> Iterator[Table | str]:
    """Yield what is the same for all named runs, then their tables; figures that no run knows are left out."""
    values = {key: {_text(run.get(key)) for run in runs.values()} for key in NAMES}
    same = {key: next(iter(found)) for key, found in values.items() if len(found) == 1 and key in IN_TITLE}
    if shared := ", ".join(f"{key} {value}" for key, value in same.items() if value != UNKNOWN):
        yield shared
    differing = [key for key in values if len(values[key]) > 1]
    for title, columns in TABLES.items():
        known = [column for column in columns if any(column.is_known(column.of(run)) for run in runs.values())]
        if not known:
            continue
        table = new_table(title, "run", *differing, *(column.title for column in known), texts=1 + len(differing))
        for name, run in runs.items():
            figures = (column.text(column.of(run)) for column in known)
            table.add_row(_broken(name), *(_text(run.get(key)) for key in differing), *figures)
        yield ""
        yield table
        yield from (NOTES[column.title] for column in known if column.title in NOTES)


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
