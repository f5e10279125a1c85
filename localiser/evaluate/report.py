"""Draw the picture of a run: path on the map, uncertainty and errors, edges, confidence, residuals.

Without the truth the errors are missing, and nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from localiser.documents import drafted
from localiser.evaluate import panels
from localiser.evaluate.accuracy import Track, errors_against
from localiser.evaluate.metrics import PAUSE_LONGER_THAN_S
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 100
SIZE_IN = (16.0, 10.5)
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


def write_report(path: Path, track: Track, figures: Mapping[str, Any], **known: Any) -> None:
    """Write the report of a run as a PNG of 1600×1050 pixels; the same run gives the same bytes.

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
        on_map, position, heading, edges, confidence, residuals = _lay_out(figure, wide=wide)
        panels.draw_map(on_map, track, errors, truth, landmark_map, _odometry_label(figures), landmark_use)
        panels.draw_position_error(position, track, errors, bound)
        panels.draw_heading_error(heading, track, errors)
        panels.draw_edges(edges, track)
        panels.draw_confidence(confidence, track)
        panels.draw_residuals(residuals, track)
        for axes in (edges, residuals) if wide else (confidence, residuals):
            axes.set_xlabel("time (s)")
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


def _lay_out(figure: Figure, *, wide: bool) -> list[Axes]:
    """Return the panels: map, position, heading, edges, confidence, residuals."""
    frame = {"left": 0.05, "right": 0.975, "bottom": 0.06, "top": 0.93, "hspace": 0.5}
    if wide:
        grid = figure.add_gridspec(3, 6, height_ratios=(1.25, 1, 1), wspace=0.75, **frame)
        places = (grid[0, :], grid[1, :2], grid[1, 2:4], grid[2, :3], grid[1, 4:], grid[2, 3:])
    else:
        grid = figure.add_gridspec(4, 2, width_ratios=(1.15, 1), wspace=0.14, **frame)
        places = (grid[:3, 0], grid[0, 1], grid[1, 1], grid[2, 1], grid[3, 0], grid[3, 1])
    return [figure.add_subplot(place) for place in places]
