"""Draw the report of a run: path, errors over time inside their bands, edges a frame, key figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from localiser.evaluate import panels
from localiser.evaluate.accuracy import Track, errors_against
from localiser.evaluate.pauses import PAUSE_LONGER_THAN_S
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 100
SIZE_IN = (16.0, 10.0)
WIDE = 2.0  # a map at least this many times wider than high gets the whole width
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so the picture is the same everywhere
    "font.size": 10.5,
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
ODOMETRIES = {"wheel": "wheels", "vision": "vision", "both": "wheels and vision"}
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
# Label, key in the metrics, format: the figures at the top.
KEY_FIGURES = (
    ("position RMSE", "position_rmse_m", "{:.3f} m"),
    ("position median", "position_median_m", "{:.3f} m"),
    ("position maximum", "position_max_m", "{:.3f} m"),
    ("heading RMSE", "heading_rmse_deg", "{:.2f}°"),
    ("odometry alone", "odometry_position_rmse_m", "{:.3f} m"),
    ("NEES (consistent: 3)", "nees_mean", "{:.1f}"),
    ("RMSE / bound", "efficiency", "{:.2f}"),
    ("edges a frame", "edges_per_frame", "{:.1f}"),
    ("time a frame", "frame_ms_median", "{:.0f} ms"),
)


def write_report(path: Path, track: Track, figures: Mapping[str, Any], **known: Any) -> None:
    """Write the report of a run as a PNG of 1600×1000 pixels; the same run gives the same bytes.

    known: see `draw_report`. Raises InputError when truth and run share no time.
    """
    with _style():  # fonts are looked up on drawing
        figure = draw_report(track, figures, **known)
        # Without "Software", which names matplotlib's version.
        figure.savefig(path, format="png", dpi=DPI, metadata={"Software": None})


def draw_report(
    track: Track,
    figures: Mapping[str, Any],
    *,
    truth: Trajectory | None = None,
    landmark_map: LandmarkMap | None = None,
    bound: Array | None = None,
) -> Figure:
    """Return the report as a figure that no window or global state holds.

    figures: as `metrics` returns them. bound: (T, 3, 3) posterior Cramér-Rao bound. Raises InputError when truth and
    run share no time.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with _style():
        figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white")
        FigureCanvasAgg(figure)
        track, bound = _broken_at_gaps(track, bound)
        errors = errors_against(track, truth) if truth is not None else None
        width, height = np.diff(panels.framed([track.poses], landmark_map), axis=1)[:, 0]
        wide = bool(width > WIDE * height)
        on_map, position, heading, edges = _lay_out(figure, wide=wide)
        panels.draw_map(on_map, track, errors, truth, landmark_map, _odometry_label(figures))
        panels.draw_position_error(position, track, errors, bound)
        panels.draw_heading_error(heading, track, errors)
        panels.draw_edges(edges, track)
        for axes in (position, heading, edges) if wide else (edges,):
            axes.set_xlabel("time (s)")
        _draw_header(figure, figures)
    return figure


def _style() -> Any:
    """Return the context of this style, from the defaults and not the user's: the picture is the same everywhere."""
    from matplotlib import style

    return style.context(["default", STYLE])


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


def _lay_out(figure: Figure, *, wide: bool) -> list[Axes]:
    frame = {"left": 0.05, "right": 0.975, "bottom": 0.065, "top": 0.80}
    if wide:
        grid = figure.add_gridspec(2, 3, height_ratios=(1.25, 1), hspace=0.3, wspace=0.2, **frame)
        return [figure.add_subplot(grid[0, :]), *(figure.add_subplot(grid[1, i]) for i in range(3))]
    grid = figure.add_gridspec(3, 2, width_ratios=(1.15, 1), hspace=0.32, wspace=0.14, **frame)
    return [figure.add_subplot(grid[:, 0]), *(figure.add_subplot(grid[i, 1]) for i in range(3))]


def _draw_header(figure: Figure, figures: Mapping[str, Any]) -> None:
    figure.text(0.05, 0.948, str(figures["log"]), fontsize=22, fontweight="bold", va="center")
    parts = [text.format(figures[key]) for key, text in ABOUT if figures.get(key) is not None]
    figure.text(0.975, 0.98, "  ·  ".join(parts), fontsize=11, color=panels.MUTED, ha="right", va="center")

    known = [(label, text.format(figures[key])) for label, key, text in KEY_FIGURES if figures.get(key) is not None]
    for place, (label, value) in enumerate(known):
        left = 0.05 + place * 0.925 / len(KEY_FIGURES)
        figure.text(left, 0.902, value, fontsize=15, fontweight="bold", va="center")
        figure.text(left, 0.875, label, fontsize=9, color=panels.MUTED, va="center")
