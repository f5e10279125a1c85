"""The picture of what was found: the image, its vertical edges by how certain they are, and what the mount says.

The mount alone predicts lines: vertical edges of round bearings, which meet at the nadir point, and the horizon.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.evaluate import picture_style, save_figure
from localiser.geometry import Array
from localiser.storage import Image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import LinearSegmentedColormap, LogNorm
    from matplotlib.figure import Figure

DPI = 100
_LEAST_PX = 1000  # width of the image in the picture
_HEAD_PX, _TITLE_PX, _FOOT_PX, _MARGIN_PX = 62, 50, 78, 22
_GROUND, _INK, _MUTED = "#14181d", "#f2f5f8", "#9fabb8"
_REJECTED, _HORIZON = "#c7cdd4", "#7ee0a1"
# Certain edges are blue, doubtful ones red; the middle is the lightest, so that it can be read without colour vision.
_CERTAINTY = ("#35b6ff", "#9fe3ff", "#fff2a8", "#ffa24d", "#ff5a45")
_SIGMA_DEG = (0.01, 1.0)
_DIMMED = 1.45  # the image's white is drawn as this share of full white's inverse, so that lines stand out
_SURE_SHARE = 0.2  # a range less certain than this is not worth its label
_BENT_STEPS = 9
_STEPS = 129
_WIDEST_DEG = 80.0
_FEW_LINES = 9
_LEAST_DEPTH = 0.02


def save_picture(path: Path, image: Image, camera: Camera, edges: Edges, *, title: str) -> None:
    """Write the picture of one image (H, W) as PNG. Raises OutputError."""
    with picture_style({"font.size": 10, "text.color": _INK}):
        save_figure(draw_picture(image, camera, edges, title=title), path)


def draw_picture(image: Image, camera: Camera, edges: Edges, *, title: str) -> Figure:
    """Return the picture as a figure; an image too small to see anything in is drawn a whole number of times larger."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    zoom = max(1, -(-_LEAST_PX // camera.width))
    panel = np.array([camera.width, camera.height]) * zoom
    size = panel + np.array([2 * _MARGIN_PX, _HEAD_PX + _TITLE_PX + _FOOT_PX])
    figure = Figure(figsize=tuple(size / DPI), dpi=DPI, facecolor=_GROUND)
    FigureCanvasAgg(figure)
    top = _HEAD_PX + _TITLE_PX
    axes = figure.add_axes(tuple(np.array([_MARGIN_PX, size[1] - top - panel[1], *panel]) / [*size, *size]))
    _draw_panel(axes, image, camera, edges, zoom)
    _draw_title(axes, edges)
    _draw_head(figure, size, camera, title, zoom)
    _draw_legend(figure, size)
    return figure


# -- a panel ----------------------------------------------------------------------------------------------------------


def _draw_panel(axes: Axes, image: Image, camera: Camera, edges: Edges, zoom: int) -> None:
    extent = (-0.5, camera.width - 0.5, camera.height - 0.5, -0.5)
    larger = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC) if zoom > 1 else image
    axes.imshow(larger, cmap="gray", vmin=0, vmax=255 * _DIMMED, extent=extent, interpolation="nearest", aspect="auto")
    axes.set(xlim=extent[:2], ylim=extent[2:], xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    _draw_guides(axes, camera)
    _draw_lines(axes, camera, edges)
    _draw_rings(axes, edges)
    _annotate(axes, edges)


def _draw_guides(axes: Axes, camera: Camera) -> None:
    """Draw where vertical edges of round bearings would run, and the horizon."""
    for bearing_deg in bearings_shown(camera):
        line = meridian(camera, float(np.deg2rad(bearing_deg)))
        if len(line) < 2:
            continue
        axes.plot(*line.T, ":", color=_INK, linewidth=0.9, alpha=0.4, zorder=2)
        top = line[line[:, 1].argmin()]
        if top[1] < 0.03 * camera.height:
            axes.annotate(
                f"{bearing_deg:+.0f}°" if bearing_deg else "0°", (top[0], -0.5), xytext=(0, 4),
                textcoords="offset points", ha="center", va="bottom", fontsize=9, color=_MUTED, annotation_clip=False,
            )  # fmt: skip
    line = horizon(camera)
    if len(line) > 1:
        axes.plot(*line.T, "--", color=_HORIZON, linewidth=1.1, alpha=0.75, zorder=2)


def _draw_lines(axes: Axes, camera: Camera, edges: Edges) -> None:
    from matplotlib.collections import LineCollection

    known = np.isfinite(edges.ends_px).all(axis=(1, 2))
    lines = _bent(edges.ends_px[known], camera)
    colours = _certainty()(_scale()(np.rad2deg(edges.bearing_sigma[known])))
    for polylines, colour, width, alpha, order in (
        (_bent(edges.rejected_px, camera), _REJECTED, 0.8, 0.55, 3),
        (lines, "black", 4.2, 0.55, 4),
        (lines, colours, 2.2, None, 5),
    ):
        axes.add_collection(LineCollection(list(polylines), colors=colour, linewidths=width, alpha=alpha, zorder=order))
    middle = lines[:, [0, -1]].mean(axis=1) if lines.shape[1] == 2 else lines[:, lines.shape[1] // 2]
    for sign, marker in ((1, 5), (-1, 4)):  # carets to the right and to the left, with their bases on the edge
        _mark(axes, middle[edges.polarity[known] == sign], marker, 6, (_INK, "black", 0.5), 6)


def _draw_rings(axes: Axes, edges: Edges) -> None:
    """Ring every lower end that can be a foot, and cross out those that lie outside or above the horizon."""
    can_be_foot = np.isfinite(edges.foot_range_m)
    feet, outside = edges.ends_px[can_be_foot, 0], edges.ends_px[~can_be_foot, 0]
    beside = outside.clip([0, 0], [axes.get_xlim()[1] - 3, axes.get_ylim()[0] - 3])  # whole, inside the picture
    _mark(axes, beside, "x", 7, ("black", "black", 3.5), 6)
    _mark(axes, beside, "x", 6, (_INK, _INK, 1.5), 7)
    _mark(axes, feet, "o", 9, ("none", "black", 3), 6)
    _mark(axes, feet, "o", 9, ("none", _INK, 1.5), 7)


def _mark(axes: Axes, points: Array, marker: str | int, size: float, paint: tuple[str, str, float], order: int) -> None:
    """Mark points (K, 2) of the image. paint: colour inside, colour and width of the border."""
    inside, border, width = paint
    style: dict[str, Any] = {"markeredgecolor": border, "markeredgewidth": width, "zorder": order}
    axes.plot(*points.T, linestyle="none", marker=marker, markersize=size, color=inside, **style)


def _annotate(axes: Axes, edges: Edges) -> None:
    """Write an edge's number at its top, and its range at its foot where that is sure."""
    from matplotlib.patheffects import withStroke

    style: dict[str, Any] = {
        "path_effects": [withStroke(linewidth=2.5, foreground="black")], "textcoords": "offset points",
        "ha": "center", "va": "center", "fontsize": 9, "fontweight": "bold", "zorder": 9, "annotation_clip": True,
    }  # fmt: skip
    is_sure = edges.foot_range_sigma_m < _SURE_SHARE * edges.foot_range_m
    for index, (bottom, top) in enumerate(edges.ends_px):
        axes.annotate(str(index + 1), tuple(top), xytext=(0, 9), **style)
        if is_sure[index]:
            axes.annotate(f"{edges.foot_range_m[index]:.1f} m", tuple(bottom), xytext=(0, -13), **style)


def _bent(ends_px: Array, camera: Camera) -> Array:
    """Return polylines (E, S, 2) between ends (E, 2, 2) of the image as taken, as the lens bends a straight line."""
    ends = ends_px[np.isfinite(ends_px).all(axis=(1, 2))]
    if not camera.is_distorted or len(ends) == 0:
        return ends
    straight = camera.image_from_pixels(ends)
    along = np.linspace(0.0, 1.0, _BENT_STEPS)[:, None]
    return camera.pixels_from_image(straight[:, None, 0] * (1 - along) + straight[:, None, 1] * along)


# -- around the panels ------------------------------------------------------------------------------------------------


def _draw_title(axes: Axes, edges: Edges) -> None:
    text = f"vertical edges: {len(edges)}, segments rejected: {len(edges.rejected_px)}"
    place: dict[str, Any] = {"textcoords": "offset points", "va": "bottom", "xycoords": "axes fraction"}
    axes.annotate(text, (1, 1), xytext=(0, 17), ha="right", color=_MUTED, **place)


def _draw_head(figure: Figure, size: Array, camera: Camera, title: str, zoom: int) -> None:
    mount = camera.mount
    tilt, roll = np.rad2deg([mount.tilt_rad, mount.roll_rad])
    size_px = f"{camera.width}×{camera.height}"
    parts = [size_px, f"tilt {tilt:.2f}°", f"roll {roll:.2f}°", f"height {mount.height_m:.2f} m"]
    if abs(tilt) > 1:
        u, v = camera.nadir_px
        parts.append(f"nadir point ({u:.0f}, {v:.0f}) px")
    if zoom > 1:
        parts.append(f"drawn {zoom}×")
    left, line = _MARGIN_PX / size[0], 1 - np.array([24, 46]) / size[1]
    figure.text(left, line[0], title, fontsize=15, fontweight="bold", va="center")
    figure.text(left, line[1], "  ·  ".join(parts), fontsize=9.5, color=_MUTED, va="center")


def _draw_legend(figure: Figure, size: Array) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.lines import Line2D

    bar = figure.add_axes((1.6 * _MARGIN_PX / size[0], 34 / size[1], 200 / size[0], 9 / size[1]))
    figure.colorbar(ScalarMappable(_scale(), _certainty()), cax=bar, orientation="horizontal", extend="both")
    bar.set_xticks([0.01, 0.1, 1.0], ["0.01°", "0.1°", "1°"], color=_MUTED, fontsize=9)
    bar.tick_params(which="both", length=0)
    bar.set_title("sigma of the bearing", fontsize=9.5, loc="left", pad=5)
    bar.spines[:].set_visible(False)
    ring: dict[str, Any] = {"marker": "o", "markersize": 8, "markerfacecolor": "none", "markeredgewidth": 1.5}
    signs: dict[str, dict[str, Any]] = {
        "lighter side": {"linestyle": "none", "marker": 5},
        "lower end, with range if it is on the floor": {"linestyle": "none", **ring},
        "lower end outside, or above the horizon": {"linestyle": "none", "marker": "x", "markersize": 6},
        "segment, not vertical": {"color": _REJECTED, "alpha": 0.7, "linewidth": 1},
        "bearing, to the nadir point": {"alpha": 0.6, "linestyle": ":", "linewidth": 1.2},
        "horizon": {"color": _HORIZON, "linestyle": "--", "linewidth": 1.2},
    }
    handles = [Line2D([], [], label=label, **{"color": _INK, **style}) for label, style in signs.items()]
    figure.legend(
        handles=handles, loc="center right", bbox_to_anchor=(1 - _MARGIN_PX / size[0] / 2, 40 / size[1]),
        ncols=4, frameon=False, fontsize=9.5, labelcolor=_INK, handlelength=1.6, columnspacing=1.6,
    )  # fmt: skip


def _certainty() -> LinearSegmentedColormap:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("certainty", _CERTAINTY)


def _scale() -> LogNorm:
    from matplotlib.colors import LogNorm

    return LogNorm(*_SIGMA_DEG)


# -- what the mount predicts -------------------------------------------------------------------------------------------


def bearings_shown(camera: Camera) -> Array:
    """Return round bearings in degrees across the view, so few that they stay apart."""
    a, e = _border(camera)
    depth = _depth(camera, e)
    tangent = (a / depth)[depth > _LEAST_DEPTH]
    low, high = np.rad2deg(np.arctan([tangent.min(), tangent.max()])).clip(-_WIDEST_DEG, _WIDEST_DEG)
    step = next((step for step in (1, 2, 5, 10) if high - low <= _FEW_LINES * step), 20)
    return np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step


def meridian(camera: Camera, bearing_rad: float) -> Array:
    """Return pixels (S, 2) along the image line of a vertical edge at this bearing, those inside the image."""
    _, border_e = _border(camera)
    e = np.linspace(border_e.min(), border_e.max(), _STEPS)
    e = e[_depth(camera, e) > _LEAST_DEPTH]
    return _inside(camera, np.stack([geometry.edge_a_at(e, bearing_rad, camera.mount.tilt_rad), e], axis=-1))


def horizon(camera: Camera) -> Array:
    """Return pixels (S, 2) of points infinitely far away at the camera's height, those inside the image."""
    reach = np.abs(camera.image_from_pixels(camera.border_px(33, 0.5))).max() * 1.5
    a = np.linspace(-reach, reach, 2 * _STEPS)
    return _inside(camera, np.stack([a, np.full_like(a, np.tan(camera.mount.tilt_rad))], axis=-1))


def _border(camera: Camera) -> Array:
    """Return upright coordinates a and e (2, P) of the image's border."""
    return camera.upright_from_pixels(camera.border_px(33, 0.5).reshape(-1, 2)).T


def _depth(camera: Camera, e: Array) -> Array:
    return np.asarray(np.cos(camera.mount.tilt_rad) + e * np.sin(camera.mount.tilt_rad))


def _inside(camera: Camera, upright: Array) -> Array:
    upright = upright[np.linalg.norm(upright, axis=-1) < camera.lens_radius]
    pixels = camera.pixels_from_upright(upright)
    size = np.array([camera.width, camera.height])
    return np.asarray(pixels[np.all((pixels > -1.5) & (pixels < size + 0.5), axis=-1)])
