"""The figure: four turned views with one edge marked, errors of turns, errors of driving."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from localiser.evaluate import picture_style
from paper.equations import TABLE_2
from paper.motions import VIEWS, Measured
from paper.results import METHODS, drive_errors, track, turn_errors
from paper.room import SIZES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 100
_SIZE_IN = (14.0, 9.6)
_INK, _MUTED, _FAINT = "#1f2933", "#6b7785", "#e3e8ed"
_COLOURS = ("#d55e00", "#56b4e9", "#0072b2")  # Okabe and Ito, one for each method
_LINES, _MARKERS = ("--", "-"), ("o", "D")  # one for each size, the small one hollow


def figure_png(found: Measured) -> bytes:
    """Return the figure as a PNG; the same measurements give the same bytes."""
    with picture_style():
        figure = _draw(found)
        figure.canvas.draw()
        pixels = np.asarray(figure.canvas.buffer_rgba())  # type: ignore[attr-defined]
    return bytes(cv2.imencode(".png", cv2.cvtColor(pixels, cv2.COLOR_RGBA2BGR))[1])


def _draw(found: Measured) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_IN, dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 1, height_ratios=(1, 1.55), left=0.06, right=0.98, bottom=0.075, top=0.9, hspace=0.42)
    views = grid[0].subgridspec(1, VIEWS, wspace=0.04)
    _draw_views([figure.add_subplot(views[index]) for index in range(VIEWS)], found)
    below = grid[1].subgridspec(1, 2, wspace=0.16)
    _draw_turns(figure.add_subplot(below[0]), found)
    _draw_drives(figure.add_subplot(below[1]), found)
    _draw_legend(figure)
    figure.text(0.06, 0.955, "Using camera tilt to assist with localisation", fontsize=18, fontweight="bold")
    figure.text(0.98, 0.958, "[Taylor06], measured again from rendered images", fontsize=11, color=_MUTED, ha="right")
    return figure


def _draw_legend(figure: Figure) -> None:
    from matplotlib.lines import Line2D

    handles = []
    for method, colour in zip(METHODS, _COLOURS, strict=True):
        for size, line, marker in zip(SIZES, _LINES, _MARKERS, strict=True):
            inside = colour if size == SIZES[-1] else "white"
            style: dict[str, Any] = {"linestyle": line, "marker": marker, "markersize": 5, "markerfacecolor": inside}
            handles.append(Line2D([], [], color=colour, label=f"{size[0]}×{size[1]}, {method.name}", **style))
    style = {"linestyle": "none", "marker": "v", "markersize": 8}
    handles.append(Line2D([], [], color=_INK, label="the paper's real robot, ψ − δ of its images", **style))
    place: dict[str, Any] = {"loc": "center", "bbox_to_anchor": (0.52, 0.565)}
    figure.legend(handles=handles, ncols=4, handlelength=3.2, columnspacing=2, **place)


def _draw_views(panels: list[Axes], found: Measured) -> None:
    """Draw the views of `table_2` as the paper's figure 5: 176×144, the camera turning right, one edge marked."""
    place, landmark = track(found) or (0, -1)
    at = found[SIZES[0], "hough"][place]
    for index, axes in enumerate(panels):
        view = at.turned[index]
        axes.imshow(at.images[index], cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        for ends, own in zip(view.edges.ends_px, view.landmark == landmark, strict=True):
            style: dict[str, Any] = {"color": _COLOURS[0], "linewidth": 3.5} if own else {"color": _COLOURS[1]}
            axes.plot(*ends.T, **style)
        axes.set(xticks=[], yticks=[], xlim=(-0.5, SIZES[0][0] - 0.5), ylim=(SIZES[0][1] - 0.5, -0.5))
        axes.set_title(f"image {index + 1}" if index else "image 1, Hough's edges, 176×144", fontsize=10.5)
        axes.spines[:].set_visible(False)


def _draw_turns(axes: Axes, found: Measured) -> None:
    for size, line in zip(SIZES, _LINES, strict=True):
        for method, colour in zip(METHODS, _COLOURS, strict=True):
            error = np.sort(np.abs(np.rad2deg(turn_errors(found, size, method, 1)[0])))
            share = (np.arange(len(error)) + 1) / max(len(error), 1)
            axes.plot(np.maximum(error, 1e-4), share, line, color=colour, linewidth=1.9)
    for image, delta, psi in TABLE_2:
        axes.plot(abs(psi - delta), 0.03, "v", color=_INK, markersize=8, clip_on=False, zorder=5)
        axes.annotate(str(image), (abs(psi - delta), 0.03), xytext=(0, 7), textcoords="offset points", ha="center")
    axes.set(
        xscale="log", xlim=(5e-4, 20), ylim=(0, 1), xlabel="|ψ − true| of one edge (degrees)", ylabel="share of edges"
    )
    axes.grid(color=_FAINT)
    axes.set_title("Turns by 10°")


def _draw_drives(axes: Axes, found: Measured) -> None:
    for size, marker in zip(SIZES, _MARKERS, strict=True):
        for method, colour in zip(METHODS, _COLOURS, strict=True):
            errors = drive_errors(found, size, method)
            filled: dict[str, Any] = {"markerfacecolor": colour if size == SIZES[-1] else "none"}
            axes.plot(
                np.abs(errors["bearing_deg"]), 100 * np.abs(errors["forward_m"]), marker, markersize=4.5,
                markeredgecolor=colour, linestyle="none", **filled,
            )  # fmt: skip
    axes.axhline(25, color=_INK, linewidth=1)
    axes.annotate("the whole drive", (0.99, 25), xycoords=("axes fraction", "data"), xytext=(0, 4), ha="right",
                  textcoords="offset points", fontsize=9.5)  # fmt: skip
    axes.set(yscale="log", ylim=(0.005, 2000), xlim=(0, 35), xlabel="|bearing| of the edge (degrees)")
    axes.set_ylabel("error of d (cm)")
    axes.grid(color=_FAINT)
    axes.set_title("Driving 25 cm ahead, by eq. 11")
