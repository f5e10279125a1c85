"""A picture of tilt and roll over a log: every image's own, and what all of them together say."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from localiser.calibration.log_mount import LogMount
from localiser.documents import drafted
from localiser.geometry import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED, FAINT = "#1f2933", "#6b7785", "#e3e8ed"
IMAGE, FOUND, STATED = "#56b4e9", "#0072b2", "#d55e00"
_DPI = 120
_STYLE = {"font.size": 11, "axes.edgecolor": MUTED, "axes.spines.top": False, "axes.spines.right": False}


def save_mount_plot(path: Path, found: LogMount, seconds: Array, title: str) -> None:
    """Write the picture as a PNG file. seconds: (F,) when the images were taken. Raises OutputError."""
    from matplotlib import style

    with style.context(["default", _STYLE]):
        figure = draw_mount(found, seconds, title)
        with drafted(path) as draft:
            figure.savefig(draft, format="png", dpi=_DPI, metadata={"Software": None})


def draw_mount(found: LogMount, seconds: Array, title: str) -> Figure:
    """Return the picture as a figure that no window holds."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.4), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 1, sharex=True)
    for axis, (axes, name) in enumerate(zip(panels, ("tilt", "roll"), strict=True)):
        _draw(axes, found, seconds, axis, name)
    panels[1].set_xlabel("time (s)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.text(0.07, 0.955, title, fontsize=15, fontweight="bold", color=INK, va="center")
    figure.legend(handles, labels, loc="center right", bbox_to_anchor=(0.985, 0.955), ncols=4, frameon=False)
    figure.subplots_adjust(left=0.07, right=0.98, bottom=0.09, top=0.86, hspace=0.28)
    return figure


def _draw(axes: Axes, found: LogMount, seconds: Array, axis: int, name: str) -> None:
    image, sigma = np.rad2deg(found.image_mount[:, axis]), np.rad2deg(np.sqrt(found.image_cov[:, axis, axis]))
    mean, mean_sigma, stated = (np.rad2deg(values[axis]) for values in (found.mount, found.sigma, found.stated))
    axes.errorbar(
        seconds, image, sigma, fmt=".", color=IMAGE, ecolor=IMAGE, elinewidth=0.8, markersize=4, alpha=0.7, zorder=2,
        label="one image, ±1σ",
    )  # fmt: skip
    axes.axhspan(mean - 3 * mean_sigma, mean + 3 * mean_sigma, color=FOUND, alpha=0.25, linewidth=0, zorder=3)
    axes.axhline(mean, color=FOUND, linewidth=1.6, zorder=4, label="all images, ±3σ")
    axes.axhline(stated, color=STATED, linewidth=1.6, linestyle="--", zorder=4, label="stated")
    low, high = _limits(image, sigma, float(mean), float(stated))
    axes.set(ylabel="degrees", ylim=(low, high), xlim=_around(seconds))
    beyond = "" if low < stated < high else ", off this scale"
    axes.set_title(f"{name}: {mean:.3f}° ± {mean_sigma:.3f}°, stated {stated:.3f}°{beyond}", loc="left", fontsize=11)
    axes.grid(axis="y", color=FAINT, linewidth=0.8)
    axes.set_axisbelow(True)


def _limits(image: Array, sigma: Array, mean: float, stated: float) -> tuple[float, float]:
    """Return limits that show nearly all images that know something, and what is stated unless it is far from them."""
    known = sigma <= 3 * np.median(sigma)
    reach = 1.3 * max(float(np.quantile(np.abs(image[known] - mean), 0.98)), 3 * float(np.median(sigma)))
    if abs(stated - mean) < 3 * reach:
        reach = max(reach, 1.15 * abs(stated - mean))
    return mean - reach, mean + reach


def _around(seconds: Array) -> tuple[float, float]:
    margin = max(0.02 * float(np.ptp(seconds)), 0.05)
    return float(seconds.min()) - margin, float(seconds.max()) + margin
