"""Draw the report of a run: path on the map, uncertainty and errors, edges, confidence, residuals, key figures.

Without the truth the errors are missing, and nothing else.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from localiser.documents import drafted
from localiser.evaluate import panels
from localiser.evaluate.accuracy import Track, errors_against
from localiser.evaluate.metrics import PAUSE_LONGER_THAN_S
from localiser.evaluate.tables import figure_at, learnt_constants
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 100
SIZE_IN = (16.0, 12.0)
WIDE = 2.0  # a map at least this many times wider than high gets the whole width
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so the picture is the same everywhere
    "font.size": 10.5,
    "text.parse_math": False,  # names of logs and maps are no formulas
    "text.color": panels.INK,
    "axes.labelcolor": panels.MUTED,
    "axes.edgecolor": panels.LANDMARK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.titlesize": 11.5,
    "axes.titlepad": 8,
    "axes.axisbelow": True,
    "xtick.color": panels.MUTED,
    "ytick.color": panels.MUTED,
    "legend.frameon": False,
    "legend.fontsize": 9.5,
    "legend.borderaxespad": 0.2,
}
ODOMETRIES = {"wheel": "wheels", "vision": "vision"}
# Key in the metrics, how it reads: what tells runs apart, at the top right.
ABOUT = (
    ("observation", "{}"),
    ("association", "associations {}"),
    ("odometry", "odometry {}"),
    ("start", "start {}"),
    ("map", "map {}"),
    ("particles", "{} particles"),
    ("seed", "seed {}"),
    ("frames", "{} frames"),
)


class KeyFigure(NamedTuple):
    """A figure at the top: its label, its key in the metrics (dots for groups), its format, and a factor."""

    label: str
    key: str
    text: str
    per: float = 1.0


# What a run knows of itself; then, where the truth is known, its errors.
OWN_FIGURES = (
    KeyFigure("found after", "confidence.found_s", "{:.1f} s"),
    KeyFigure("images sure", "confidence.sure", "{:.1f} %", 100.0),
    KeyFigure("edges matched", "edges_matched", "{:.0f} %", 100.0),
    KeyFigure("residuals (right: 1)", "residuals.consistency", "{:.2f}"),
    KeyFigure("3σ, median", "position_3sigma_median_m", "{:.3f} m"),
    KeyFigure("3σ, worst", "position_3sigma_max_m", "{:.3f} m"),
    KeyFigure("3σ of heading", "heading_3sigma_median_deg", "{:.2f}°"),
    KeyFigure("distance", "distance_m", "{:.1f} m"),
    KeyFigure("mean speed", "speed_mean_m_s", "{:.2f} m/s"),
    KeyFigure("time an image", "frame_ms_median", "{:.0f} ms"),
)
ERROR_FIGURES = (
    KeyFigure("position RMSE", "position_rmse_m", "{:.3f} m"),
    KeyFigure("position median", "position_median_m", "{:.3f} m"),
    KeyFigure("position maximum", "position_max_m", "{:.3f} m"),
    KeyFigure("heading RMSE", "heading_rmse_deg", "{:.2f}°"),
    KeyFigure("odometry alone", "odometry_position_rmse_m", "{:.3f} m"),
    KeyFigure("sure and wrong", "confidence.sure_and_wrong", "{:.1f} %", 100.0),
    KeyFigure("NEES (right: 3)", "nees_mean", "{:.1f}"),
    KeyFigure("RMSE / bound", "efficiency", "{:.2f}"),
)


def write_report(path: Path, track: Track, figures: Mapping[str, Any], **known: Any) -> None:
    """Write the report of a run as a PNG of 1600×1200 pixels; the same run gives the same bytes.

    known: see `draw_report`. Raises InputError when truth and run share no time, OutputError.
    """
    with picture_style():  # fonts are looked up on drawing
        save_figure(draw_report(track, figures, **known), path)


def draw_report(
    track: Track,
    figures: Mapping[str, Any],
    *,
    truth: Trajectory | None = None,
    landmark_map: LandmarkMap | None = None,
    bound: Array | None = None,
    landmark_use: Array | None = None,
) -> Figure:
    """Return the report as a figure that no window or global state holds.

    figures: as `metrics` returns them. bound: (T, 3, 3) posterior Cramér-Rao bound. landmark_use: see `draw_map`.
    Raises InputError when truth and run share no time.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with picture_style():
        figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white")
        FigureCanvasAgg(figure)
        track, bound = _broken_at_gaps(track, bound)
        errors = errors_against(track, truth) if truth is not None else None
        width, height = np.diff(panels.framed([track.poses], landmark_map), axis=1)[:, 0]
        wide = bool(width > WIDE * height)
        on_map, position, heading, edges, confidence, residuals = _lay_out(
            figure, wide=wide, headed=0.84 if errors is None else 0.795
        )
        panels.draw_map(on_map, track, errors, truth, landmark_map, _odometry_label(figures), landmark_use)
        panels.draw_position_error(position, track, errors, bound)
        panels.draw_heading_error(heading, track, errors)
        panels.draw_edges(edges, track)
        panels.draw_confidence(confidence, track)
        panels.draw_residuals(residuals, track)
        for axes in (edges, residuals) if wide else (confidence, residuals):
            axes.set_xlabel("time (s)")
        _draw_header(figure, figures)
        _draw_footer(figure, figures)
    return figure


def picture_style(changes: Mapping[str, Any] | None = None) -> Any:
    """Return the context of the one style of all pictures, from the defaults and not the user's.

    So a picture is the same everywhere. changes: to the style, by the names of matplotlib.
    """
    from matplotlib import style

    return style.context(["default", STYLE | dict(changes or {})])


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all, without what differs from run to run. Raises OutputError."""
    with drafted(path) as draft:
        figure.savefig(draft, format="png", metadata={"Software": None})  # which names matplotlib's version


def _odometry_label(figures: Mapping[str, Any]) -> str:
    """Return what the curve is called that the run's odometry alone would have led along."""
    source = figures.get("odometry")
    return "odometry alone" if source is None else f"odometry alone ({ODOMETRIES.get(source, source)})"


def _broken_at_gaps(track: Track, bound: Array | None) -> tuple[Track, Array | None]:
    # Where there was no image for long nothing is known: a row of nan keeps a line from being drawn across.
    after = np.flatnonzero(np.diff(track.t_ns) > PAUSE_LONGER_THAN_S * 1e9) + 1
    columns = {f.name: getattr(track, f.name) for f in fields(Track) if f.name != "t_ns"}
    broken = {name: np.insert(column, after, np.nan, axis=0) for name, column in columns.items()}
    t_ns = np.insert(track.t_ns, after, track.t_ns[after - 1] + 1)
    return Track(t_ns, **broken), None if bound is None else np.insert(bound, after, np.nan, axis=0)


def _lay_out(figure: Figure, *, wide: bool, headed: float) -> list[Axes]:
    """Return the panels below the header: map, position, heading, edges, confidence, residuals."""
    frame = {"left": 0.05, "right": 0.975, "bottom": 0.115, "top": headed, "hspace": 0.36}
    if wide:
        grid = figure.add_gridspec(3, 6, height_ratios=(1.25, 1, 1), wspace=0.75, **frame)
        places = (grid[0, :], grid[1, :2], grid[1, 2:4], grid[2, :3], grid[1, 4:], grid[2, 3:])
    else:
        grid = figure.add_gridspec(4, 2, width_ratios=(1.15, 1), wspace=0.14, **frame)
        places = (grid[:3, 0], grid[0, 1], grid[1, 1], grid[2, 1], grid[3, 0], grid[3, 1])
    return [figure.add_subplot(place) for place in places]


def _draw_header(figure: Figure, figures: Mapping[str, Any]) -> None:
    figure.text(0.05, 0.955, str(figures["log"]), fontsize=22, fontweight="bold", va="center")
    parts = [text.format(figures[key]) for key, text in ABOUT if figures.get(key) is not None]
    figure.text(0.975, 0.985, "  ·  ".join(parts), fontsize=11, color=panels.MUTED, ha="right", va="center")
    rows = [known for row in (ERROR_FIGURES, OWN_FIGURES) if (known := known_figures(figures, row))]
    for top, known in zip((0.916, 0.866), rows, strict=False):
        for place, (label, value) in enumerate(known):
            left = 0.05 + place * 0.925 / len(OWN_FIGURES)
            figure.text(left, top, value, fontsize=15, fontweight="bold", va="center")
            figure.text(left, top - 0.021, label, fontsize=9, color=panels.MUTED, va="center")


def known_figures(figures: Mapping[str, Any], chosen: Sequence[KeyFigure]) -> list[tuple[str, str]]:
    """Return label and text of the figures that are known; a run that was never sure was found never."""
    texts = []
    for figure in chosen:
        value = figure_at(figures, figure.key)
        if value is not None:
            texts.append((figure.label, figure.text.format(value * figure.per)))
        elif figure.label == "found after" and (figures.get("confidence") or {}).get("sure") is not None:
            texts.append((figure.label, "never"))
    return texts


def remarks(figures: Mapping[str, Any]) -> list[str]:
    """Return what a run says in words: learnt constants, gaps, warnings."""
    found = []
    if constants := learnt_constants(figures):
        found.append(f"Learnt: {', '.join(constants)}.")
    if gaps := figures.get("pauses"):
        longest = max(gap["duration_s"] for gap in gaps)
        found.append(
            f"{len(gaps)} gaps of more than {PAUSE_LONGER_THAN_S:g} s without edges, the longest {longest:.1f} s."
        )
    if used := figures.get("landmarks"):
        found.append(f"Of {used['known']} landmarks, {used['in_view']} were in view and {used['matched']} matched.")
    return [*found, *(f"Warning: {warning}" for warning in figures.get("warnings") or ())]


def _draw_footer(figure: Figure, figures: Mapping[str, Any]) -> None:
    lines = [line for remark in remarks(figures) for line in textwrap.wrap(remark, 220)]
    for number, line in enumerate(lines[:4]):
        colour = panels.WARNING if line.startswith("Warning") else panels.MUTED
        figure.text(0.05, 0.06 - 0.017 * number, line, fontsize=10, color=colour, va="center")
