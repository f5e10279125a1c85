"""A map as a picture and as a table."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, Quality
from localiser.storage import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.table import Table

    from localiser.commands.map.build import MapBuilt

_CHI2_95 = 5.991  # squared Mahalanobis distance that holds 95 % of a Gaussian in the plane
_POLARITY = {1: ("#1f6fb4", "light on the right"), -1: ("#c2571a", "light on the left"), 0: ("#555555", "unknown")}


def save_picture(landmark_map: LandmarkMap, path: Path, trajectory: Array | None = None) -> None:
    """Draw the map from above, map -z up, with the 95 % ellipse of each landmark. trajectory: (T, 2+) x, z.

    Raises OutputError when the picture cannot be written.
    """
    from matplotlib.figure import Figure

    points = landmark_map.points
    low, high = points.min(axis=0), points.max(axis=0)
    width, depth = np.maximum(high - low, 2.0)
    scale = 9.0 / max(width, depth)
    figure = Figure(figsize=(max(4.5, width * scale + 1.2), max(3.5, depth * scale + 1.6)), dpi=120)
    axes = figure.add_subplot()
    if trajectory is not None:
        axes.plot(trajectory[:, 0], trajectory[:, 1], color="#9aa4b1", linewidth=1.0, zorder=1, label="path")
    _draw_ellipses(axes, landmark_map)
    _draw_landmarks(axes, landmark_map)
    axes.set(xlabel="x, m", ylabel="z, m (map −z is up)", title=landmark_map.name or path.stem)
    axes.set_aspect("equal")
    margin = 0.04 * max(width, depth) + 0.1
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(high[1] + margin, low[1] - margin)
    axes.grid(color="#e6e8eb", linewidth=0.6)
    axes.set_axisbelow(True)
    figure.legend(loc="lower center", ncols=4, frameon=False, fontsize=8)
    figure.tight_layout(rect=(0.0, 0.05, 1.0, 1.0))
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    write_bytes(path, buffer.getvalue())


def _draw_landmarks(axes: Axes, landmark_map: LandmarkMap) -> None:
    quality = landmark_map.quality or Quality.unknown(len(landmark_map))
    opacity = np.where(np.isnan(quality.existence), 1.0, 0.25 + 0.75 * quality.existence)
    for polarity, (colour, meaning) in _POLARITY.items():
        chosen = landmark_map.polarity == polarity
        if chosen.any():
            x, z = landmark_map.points[chosen].T
            axes.scatter(x, z, s=9, color=colour, alpha=opacity[chosen], zorder=3, linewidths=0, label=meaning)


def _draw_ellipses(axes: Axes, landmark_map: LandmarkMap) -> None:
    from matplotlib.collections import EllipseCollection

    known = np.isfinite(landmark_map.cov).all(axis=(1, 2))
    if not known.any():
        return
    variance, vectors = np.linalg.eigh(landmark_map.cov[known])
    diameter = 2 * np.sqrt(_CHI2_95 * np.maximum(variance, 0.0))
    angle = np.rad2deg(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    ellipses: Any = EllipseCollection(
        diameter[:, 1],
        diameter[:, 0],
        angle,
        units="xy",
        offsets=landmark_map.points[known],
        offset_transform=axes.transData,
        facecolors="#8fb8de55",
        edgecolors="#3f6f9f",
        linewidths=0.6,
        zorder=2,
    )
    axes.add_collection(ellipses)
    axes.plot([], [], color="#3f6f9f", linewidth=0.8, label="95 % of its place")


def summary_table(landmark_map: LandmarkMap) -> Table:
    """Return what is known of the landmarks: median and the best and worst tenth of each figure."""
    from rich.table import Table

    quality = landmark_map.quality or Quality.unknown(len(landmark_map))
    sigma = np.sqrt(np.trace(landmark_map.cov, axis1=1, axis2=2) / 2)
    rows = (
        ("sigma, m", sigma, "{:.4f}"),
        ("images that show it", quality.sightings, "{:.0f}"),
        ("parallax, °", np.rad2deg(quality.parallax_rad), "{:.1f}"),
        ("probability of existence", quality.existence, "{:.3f}"),
        ("bottom, m", landmark_map.bottom_m, "{:.2f}"),
        ("top, m", landmark_map.top_m, "{:.2f}"),
    )
    table = Table(title=f"{len(landmark_map)} landmarks")
    for name in ("", "10 % below", "median", "90 % below", "known"):
        table.add_column(name, justify="left" if not name else "right")
    for name, values, form in rows:
        known = values[np.isfinite(values)]
        figures = [form.format(value) for value in np.quantile(known, (0.1, 0.5, 0.9))] if len(known) else ["–"] * 3
        table.add_row(name, *figures, str(len(known)))
    return table


def findings(built: MapBuilt) -> list[str]:
    """Return what a build without known poses found out about the robot, and how well it fits the truth if known."""
    assert built.slam is not None
    scale, rotation, veer, yaw = built.slam.constants
    lines = [
        f"Wheels say {100 * scale:+.1f} % of the distance and {100 * rotation:+.1f} % of the turns, "
        f"and {np.rad2deg(veer):+.2f}° of turn a metre that is none; "
        f"the camera's yaw is {np.rad2deg(yaw):+.2f}° from what is stated.",
    ]
    moved = np.hypot(*(built.slam.poses - built.slam.before)[:, :2].T)
    lines.append(f"Closing loops moved the robot's path by up to {moved.max():.2f} m.")
    return lines
