"""Maps as pictures: landmarks with their certainty, and how many are in view from where."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from localiser.evaluate import ellipses, picture_style, save_figure
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, Quality
from localiser.mapping import ENOUGH, Coverage, FloorPlan, map_from_cells

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CHI2_95 = 5.991  # squared Mahalanobis distance that holds 95 % of a Gaussian in the plane
# Colours of Okabe and Ito, as in the report.
_POLARITY = {
    1: ("#0072b2", "light on the right"),
    -1: ("#d55e00", "light on the left"),
    0: ("#1f2933", "lighter side unknown"),
}
_LANDMARK = "#1f2933"
_PATH, _WALL = "#6b7785", "#c4ccd4"
_LABELS = {"xlabel": "x (m)", "ylabel": "z (m), heading 0 faces up"}


def _draw_walls(axes: Axes, plan: FloorPlan) -> None:
    from matplotlib.colors import ListedColormap
    from matplotlib.transforms import Affine2D

    origin, right, up = map_from_cells(plan, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    onto_map = Affine2D(np.vstack([np.column_stack([right - origin, up - origin, origin]), [0.0, 0.0, 1.0]]))
    rows, columns = plan.shape
    axes.imshow(
        np.ma.masked_equal(plan.occupied, False),
        cmap=ListedColormap([_WALL]),
        extent=(0, columns, 0, rows),
        origin="lower",
        interpolation="nearest",
        transform=onto_map + axes.transData,
        zorder=0.5,
    )


def draw_map(landmark_map: LandmarkMap, path: Path, driven: Array | None = None, plan: FloorPlan | None = None) -> None:
    """Draw the map from above, map -z up, with the 95 % ellipse of each landmark. Raises OutputError.

    driven: the robot's poses (T, 3) in their order. plan: whose walls are drawn behind everything else.
    """
    with picture_style():
        save_figure(map_figure(landmark_map, path.stem, driven, plan), path)


def map_figure(landmark_map: LandmarkMap, name: str, driven: Array | None, plan: FloorPlan | None) -> Figure:
    """Return the figure of `draw_map`."""
    from matplotlib.figure import Figure

    points = landmark_map.points if driven is None else np.concatenate([landmark_map.points, driven[:, :2]])
    if plan is not None and plan.occupied.any():
        rows, columns = (np.flatnonzero(plan.occupied.any(axis=axis)) for axis in (1, 0))
        corners = [[column, row] for column in (columns[0], columns[-1] + 1) for row in (rows[0], rows[-1] + 1)]
        points = np.concatenate([points, map_from_cells(plan, np.array(corners, dtype=float))])
    low, high = points.min(axis=0), points.max(axis=0)
    width, depth = np.maximum(high - low, 2.0)
    scale = 9.0 / max(width, depth)
    figure = Figure(figsize=(max(4.5, width * scale + 1.2), max(3.5, depth * scale + 1.6)), dpi=120)
    axes = figure.add_subplot()
    if plan is not None:
        _draw_walls(axes, plan)
    if driven is not None:
        axes.plot(*driven[:, :2].T, color=_PATH, linewidth=1.2, zorder=1, label="path driven")
    _draw_ellipses(axes, landmark_map)
    _draw_landmarks(axes, landmark_map)
    axes.set(**_LABELS, title=landmark_map.name or name)
    axes.set_aspect("equal")
    margin = 0.04 * max(width, depth) + 0.1
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(high[1] + margin, low[1] - margin)
    axes.grid(color="#e3e8ed", linewidth=0.8)
    figure.legend(loc="lower center", ncols=4)
    figure.tight_layout(rect=(0.0, 0.05, 1.0, 1.0))
    return figure


def _draw_landmarks(axes: Axes, landmark_map: LandmarkMap) -> None:
    quality = landmark_map.quality or Quality.unknown(len(landmark_map))
    opacity = np.where(np.isnan(quality.existence), 1.0, 0.25 + 0.75 * quality.existence)
    for polarity, (colour, meaning) in _POLARITY.items():
        chosen = landmark_map.polarity == polarity
        if chosen.any():
            x, z = landmark_map.points[chosen].T
            axes.scatter(x, z, s=9, color=colour, alpha=opacity[chosen], zorder=3, linewidths=0, label=meaning)


def _draw_ellipses(axes: Axes, landmark_map: LandmarkMap) -> None:
    known = np.isfinite(landmark_map.cov).all(axis=(1, 2))
    if not known.any():
        return
    centres, covs, sigmas = landmark_map.points[known], landmark_map.cov[known], float(np.sqrt(_CHI2_95))
    style: dict[str, Any] = {"facecolors": "#56b4e955", "edgecolors": "#0072b2", "linewidths": 0.6, "zorder": 2}
    axes.add_collection(ellipses(axes, centres, covs, sigmas, **style))
    axes.plot([], [], color="#0072b2", linewidth=0.8, label="95 % of its place")


def draw_coverage(landmark_map: LandmarkMap, found: Coverage, path: Path) -> None:
    """Draw from where too few landmarks are in view; map -z up. Raises OutputError."""
    from matplotlib.figure import Figure

    width, depth = np.ptp(found.x) + 1.0, np.ptp(found.z) + 1.0
    scale = 9.0 / max(width, depth)
    half = found.step_m / 2
    extent = (found.x[0] - half, found.x[-1] + half, found.z[-1] + half, found.z[0] - half)
    with picture_style():
        figure = Figure(figsize=(max(5.0, width * scale + 1.6), max(4.0, depth * scale + 1.4)), dpi=120)
        axes = figure.add_subplot()
        few = axes.imshow(100 * found.share, extent=extent, vmin=0, vmax=100, cmap="YlOrRd", interpolation="nearest")
        x, z = landmark_map.points.T
        axes.scatter(x, z, s=10, color=_LANDMARK, linewidths=0, label="landmark")
        axes.set(**_LABELS, title=f"{landmark_map.name or path.stem}: coverage")
        axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal")
        bar = figure.colorbar(few, ax=axes, fraction=0.046, pad=0.04)
        bar.set_label(f"headings with fewer than {ENOUGH} landmarks in view, %")
        figure.legend(loc="lower center", ncols=3)
        figure.tight_layout(rect=(0.0, 0.04, 1.0, 1.0))
        save_figure(figure, path)
