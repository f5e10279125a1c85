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
from localiser.evaluate.accuracy import Errors, Track, consistency, consistency_band, dead_reckoning, errors_against
from localiser.evaluate.metrics import PAUSE_LONGER_THAN_S, find_pauses
from localiser.filter import SURE
from localiser.geometry import Array, Trajectory, forward
from localiser.landmarks import LandmarkMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import EllipseCollection
    from matplotlib.figure import Figure

# Colours are those of Okabe and Ito, which people with any colour vision can tell apart; lines differ in style too.
INK, MUTED, FAINT = "#1f2933", "#6b7785", "#e3e8ed"
ESTIMATE, BAND, TRUTH, ODOMETRY = "#0072b2", "#56b4e9", "#1f2933", "#e69f00"
MATCHED, EDGES, WARNING = "#009e73", "#b8c2cc", "#d55e00"
LANDMARK = "#9aa5b1"

GRID_STEPS_M = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)
ELLIPSES = 80  # as many 3σ ellipses along the path as can be told apart
FEWEST_THAT_FIX_A_POSE = 3

DPI = 100
SIZE_IN = (16.0, 10.5)
WIDE = 2.0  # a map at least this many times wider than high gets the whole width
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so the picture is the same everywhere
    "font.size": 10.5,
    "text.parse_math": False,  # names of logs and maps are no formulas
    "text.color": INK,
    "axes.labelcolor": MUTED,
    "axes.edgecolor": LANDMARK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.titlesize": 11.5,
    "axes.titlepad": 8,
    "axes.axisbelow": True,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
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
    landmark_use: Array | None = None,
) -> Figure:
    """Return the report as a figure that no window or global state holds.

    figures: as `metrics` returns them. landmark_use: see `draw_map`.
    Raises InputError when truth and run share no time.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with picture_style():
        figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white")
        FigureCanvasAgg(figure)
        # Where there was no image for long nothing is known: a row of nan keeps a line from being drawn across.
        after = np.flatnonzero(np.diff(track.t_ns) > PAUSE_LONGER_THAN_S * 1e9) + 1
        columns = {f.name: getattr(track, f.name) for f in fields(Track) if f.name != "t_ns"}
        broken = {name: np.insert(column, after, np.nan, axis=0) for name, column in columns.items()}
        track = Track(np.insert(track.t_ns, after, track.t_ns[after - 1] + 1), **broken)
        errors = errors_against(track, truth) if truth is not None else None
        width, height = np.diff(framed([track.poses], landmark_map), axis=1)[:, 0]
        wide = bool(width > WIDE * height)
        on_map, position, heading, edges, confidence, residuals = _lay_out(figure, wide=wide)
        source = figures.get("odometry")
        label = "odometry alone" if source is None else f"odometry alone ({ODOMETRIES.get(source, source)})"
        draw_map(on_map, track, errors, truth, landmark_map, label, landmark_use)
        off_m, off_deg = (None, None) if errors is None else (errors.position_m, np.degrees(errors.heading_rad))
        draw_error(position, track, "Position", "m", track.position_sigma_m, off_m)
        sigma_deg = np.degrees(track.heading_sigma_rad)
        draw_error(heading, track, "Heading", "degrees", sigma_deg, off_deg)
        draw_edges(edges, track)
        draw_confidence(confidence, track)
        draw_residuals(residuals, track)
        for axes in (edges, residuals) if wide else (confidence, residuals):
            axes.set_xlabel("time (s)")
    return figure


def picture_style() -> Any:
    """Return the context of the one style of all pictures, from matplotlib's defaults and not the user's."""
    from matplotlib import style

    return style.context(["default", STYLE])


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all, without what differs from run to run. Raises OutputError."""
    with drafted(path) as draft:
        figure.savefig(draft, format="png", metadata={"Software": None})  # which names matplotlib's version


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


# -- panels -----------------------------------------------------------------------------------------------------------


def draw_map(
    axes: Axes,
    track: Track,
    errors: Errors | None,
    truth: Trajectory | None,
    landmark_map: LandmarkMap | None,
    odometry_label: str = "odometry",
    landmark_use: Array | None = None,
) -> None:
    """Draw landmarks, truth, odometry and estimate as seen from above: x to the right, map -z up, equal scales.

    The truth is drawn whole from the first image to the last; odometry starts at it, or at the estimate, where the
    robot was found. Poses that are no ordinary ones are faint points. landmark_use: (L, 2) in how many images each
    landmark was in view, and in how many it was matched.
    """
    first, found = track.first_found or 0, track.found
    odometry = errors.odometry if errors else dead_reckoning(track.driven[first:], track.poses[first])
    estimate = np.where(found[:, None], track.poses, np.nan) if found.any() else track.poses
    paths = [estimate, odometry]
    if landmark_map is not None:
        _draw_landmarks(axes, landmark_map, landmark_use)
    if np.isfinite(odometry).any():
        axes.plot(*odometry[:, :2].T, "--", color=ODOMETRY, linewidth=1.8, zorder=2, label=odometry_label)
    if truth is not None:
        during = truth.poses[(truth.t_ns >= track.t_ns[0]) & (truth.t_ns <= track.t_ns[-1])]
        paths.append(during)
        axes.plot(*during[:, :2].T, color=TRUTH, linewidth=3.2, alpha=0.9, zorder=3, label="truth")
    _draw_ellipses(axes, track)
    if not found.all():
        axes.plot(*track.poses[~found, :2].T, ".", color=ESTIMATE, alpha=0.25, zorder=4, label="not found yet")
    if found.any():
        axes.plot(*estimate[:, :2].T, color=ESTIMATE, linewidth=1.5, zorder=5, label="estimate")
        _draw_ends(axes, track.poses[np.flatnonzero(found)[[0, -1]]])

    _set_equal_limits(axes, framed(paths, landmark_map))
    axes.set(xlabel="x (m)", ylabel="z (m), heading 0 faces up")
    axes.grid(color=FAINT, linewidth=0.8)
    axes.set_title("Path on the map")
    _legend_above(axes)


def _draw_landmarks(axes: Axes, landmark_map: LandmarkMap, landmark_use: Array | None) -> None:
    """Draw the landmarks, by whether they were matched, in view only, or never in view."""
    points = landmark_map.points
    if landmark_use is None:
        axes.plot(*points.T, ".", color=LANDMARK, markersize=4, zorder=1, label="landmark")
        return
    in_view, matched = (landmark_use > 0).T
    style: dict[str, Any] = {"linestyle": "none", "zorder": 1}
    kinds: tuple[tuple[str, Any, dict[str, Any]], ...] = (
        ("never in view", ~in_view & ~matched, {"marker": "o", "markersize": 3.5, "mfc": "none", "mec": LANDMARK}),
        ("never matched", in_view & ~matched, {"marker": "x", "markersize": 5.5, "mec": WARNING, "mew": 1.3}),
        ("matched", matched, {"marker": "o", "markersize": 4, "mfc": MATCHED, "mec": "none"}),
    )
    for label, chosen, kind in kinds:
        if chosen.any():
            axes.plot(*points[chosen].T, label=label, **kind, **style)


def framed(paths: list[Array], landmark_map: LandmarkMap | None) -> Array:
    """Return ((x_low, x_high), (z_low, z_high)): the paths, and landmarks around them up to as far again."""
    points = np.concatenate([path[:, :2] for path in paths])
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    if landmark_map is not None and len(landmark_map):
        around = max(5.0, float((high - low).max()))
        low = np.minimum(low, np.maximum(low - around, landmark_map.points.min(axis=0)))
        high = np.maximum(high, np.minimum(high + around, landmark_map.points.max(axis=0)))
    margin = 0.03 * float((high - low).max()) + 0.1
    return np.stack([low - margin, high + margin], axis=-1)


def draw_error(axes: Axes, track: Track, what: str, unit: str, sigma: Array, error: Array | None) -> None:
    """Draw how far the estimate is off (T,) inside three times what the filter expects; an angle on both sides of 0."""
    seconds, limit = track.seconds, 3 * np.where(track.found, sigma, np.nan)
    is_angle = unit == "degrees"
    band = (-limit, limit) if is_angle else (0, limit)
    axes.fill_between(seconds, *band, color=BAND, alpha=0.25, linewidth=0, label="±3σ" if is_angle else "3σ")
    if is_angle:
        axes.axhline(0, color=MUTED, linewidth=0.8)
    if error is not None:
        axes.plot(seconds, error, color=ESTIMATE, linewidth=1.4, label="error")
    top = _top(limit, None if error is None else np.abs(error))
    axes.set(ylabel=unit, ylim=(-top if is_angle else 0, top))
    _finish(axes, track, f"{what} uncertainty, no truth" if error is None else f"{what} error")


def draw_edges(axes: Axes, track: Track) -> None:
    """Draw the number of edges a frame, those that were matched where known, and a mark where there are too few."""
    seconds = track.seconds
    style: dict[str, Any] = {"step": "mid", "linewidth": 0}
    axes.fill_between(seconds, 0, track.edges, color=EDGES, label="measured", **style)
    counted = track.edges
    if np.isfinite(track.matched).any():
        counted = track.matched
        axes.fill_between(seconds, 0, counted, color=MATCHED, alpha=0.75, label="matched", **style)
    few = counted < FEWEST_THAT_FIX_A_POSE
    if few.any():
        height, across = np.full(int(few.sum()), 0.03), axes.get_xaxis_transform()
        label = f"< {FEWEST_THAT_FIX_A_POSE}"
        axes.plot(seconds[few], height, "|", color=WARNING, markersize=7, transform=across, label=label)
    if find_pauses(track.t_ns, track.sighted):
        axes.fill([], [], color=FAINT, alpha=0.7, label="pause")
    axes.set(ylabel="edges a frame", ylim=(0, 1.12 * max(float(np.nanmax(track.edges, initial=0)), 1)))
    _finish(axes, track, "Edges")


def draw_confidence(axes: Axes, track: Track) -> None:
    """Draw the probability that the estimate is right, and from where on the run counts as sure."""
    axes.axhline(SURE, color=MUTED, linewidth=1, linestyle="--", label=f"sure: > {SURE:g}")
    axes.plot(track.seconds, track.p_correct, color=ESTIMATE, linewidth=1.4, label="p_correct")
    unsure = track.p_correct <= SURE
    if unsure.any():
        height, across = np.full(int(unsure.sum()), 0.03), axes.get_xaxis_transform()
        axes.plot(track.seconds[unsure], height, "|", color=WARNING, markersize=7, transform=across, label="not sure")
    if not track.found.all():
        axes.fill([], [], color=ODOMETRY, alpha=0.15, label="not found yet")
    axes.set(ylabel="probability", ylim=(0, 1.04))
    _finish(axes, track, "Probability of being right")


def draw_residuals(axes: Axes, track: Track) -> None:
    """Draw how far matched edges are from their landmarks, squared, over what their sigmas make expect."""
    seconds, known = track.seconds, np.isfinite(track.residuals).all(axis=1)
    top = 3.0
    if known.any():
        low, high = np.full((2, len(track)), np.nan)
        low[known], high[known] = consistency_band(track.residuals[known])
        value = consistency(track.residuals)
        axes.fill_between(seconds, low, high, color=BAND, alpha=0.25, linewidth=0, label="95 % band")
        axes.axhline(1, color=MUTED, linewidth=0.8)
        axes.plot(seconds, value, ".", color=ESTIMATE, markersize=3.5, label="an image")
        top = max(top, 1.1 * float(np.quantile(value[known], 0.99)))
    axes.set(ylabel="χ² / expected", ylim=(0, top))
    _finish(axes, track, "Residuals of matched edges")


def _set_equal_limits(axes: Axes, box: Array) -> None:
    from matplotlib.ticker import MultipleLocator

    # Widen the box to the panel's own shape, so that one metre is as long both ways and the panel is filled.
    low, high = box.T
    panel = axes.get_window_extent().size
    span = panel * ((high - low) / panel).max()
    left, top = (low + high - span) / 2
    right, bottom = (low + high + span) / 2
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    longest = float(span.max())
    step = next((step for step in GRID_STEPS_M if longest <= 12 * step), 10.0 ** np.ceil(np.log10(longest / 12)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(step))


def ellipses(axes: Axes, centres: Array, covs: Array, sigmas: float, **style: Any) -> EllipseCollection:
    """Return the ellipses so many sigmas about points (N, 2) with covariances (N, 2, 2)."""
    from matplotlib.collections import EllipseCollection

    variance, directions = np.linalg.eigh(covs)
    minor, major = 2 * sigmas * np.sqrt(np.maximum(variance, 0)).T
    angle_deg = np.degrees(np.arctan2(directions[:, 1, 1], directions[:, 0, 1]))
    place: dict[str, Any] = {"units": "xy", "offsets": centres, "offset_transform": axes.transData}
    return EllipseCollection(major, minor, angle_deg, **place, **style)


def _draw_ellipses(axes: Axes, track: Track) -> None:
    known = np.flatnonzero(track.found & np.isfinite(track.covs[:, :2, :2]).all(axis=(1, 2)))
    if not len(known):
        return
    chosen = known[np.unique(np.linspace(0, len(known) - 1, ELLIPSES).astype(int))]
    style = {"facecolors": BAND, "alpha": 0.22, "zorder": 4}
    axes.add_collection(ellipses(axes, track.poses[chosen, :2], track.covs[chosen, :2, :2], 3.0, **style))
    axes.fill([], [], color=BAND, alpha=0.4, linewidth=0, label="3σ")  # a legend knows no collection of ellipses


def _draw_ends(axes: Axes, poses: Array) -> None:
    from matplotlib.patheffects import withStroke

    text: dict[str, Any] = {"textcoords": "offset points", "color": ESTIMATE, "fontweight": "bold", "zorder": 7}
    text["path_effects"] = [withStroke(linewidth=3, foreground="white")]
    start, end = (poses[0, 0], poses[0, 1]), (poses[-1, 0], poses[-1, 1])
    axes.plot(*start, "o", color="white", markeredgecolor=ESTIMATE, markeredgewidth=2, markersize=13, zorder=6)
    axes.annotate("start", start, xytext=(-8, -17), ha="right", **text)
    # A triangle that points where the robot faces; -z is up on the page.
    right, up = forward(poses[-1, 2]) * [1, -1]
    turn_deg = np.degrees(np.arctan2(up, right)) - 90
    axes.plot(*end, marker=(3, 0, turn_deg), color=ESTIMATE, markersize=12, markeredgecolor="white", zorder=6)
    axes.annotate("end", end, xytext=(9, 8), **text)


def _top(limit: Array, error: Array | None) -> float:
    """Return the upper end of an axis that shows the whole error, and of its band (T,) what does not flatten it.

    The band of a pause, or of the start, may be many times as high as what is otherwise to be seen.
    """
    band = limit[np.isfinite(limit)]
    highest_error = 0.0 if error is None else float(np.nanmax(error, initial=0.0))
    worth_seeing = max(highest_error, float(np.quantile(band, 0.95))) if len(band) else highest_error
    return 1.08 * max(highest_error, min(float(band.max(initial=0.0)), 2 * worth_seeing)) or 1.0


def _finish(axes: Axes, track: Track, title: str) -> None:
    axes.set_title(title)
    axes.set_xlim(0, max(float(track.seconds[-1]), 1e-3))
    axes.grid(axis="y", color=FAINT, linewidth=0.8)
    for pause in find_pauses(track.t_ns, track.sighted):
        start, end = (np.array([pause.start_ns, pause.end_ns]) - track.t_ns[0]) / 1e9
        axes.axvspan(start, end, color=FAINT, alpha=0.7, linewidth=0, zorder=0)
    lost = np.concatenate([[False], ~track.found, [False]]).astype(np.int8)
    for start, after in np.flatnonzero(np.diff(lost)).reshape(-1, 2):
        end = min(after, len(track) - 1)
        axes.axvspan(track.seconds[start], track.seconds[end], color=ODOMETRY, alpha=0.15, linewidth=0, zorder=0)
    if axes.get_legend_handles_labels()[0]:
        _legend_above(axes)


def _legend_above(axes: Axes) -> None:
    """Put the legend between title and panel, so that neither covers the other."""
    columns = 6
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, handlelength=1.5, columnspacing=1.2)
    rows = -(-len(axes.get_legend_handles_labels()[0]) // columns)
    axes.set_title(axes.get_title(loc="left"), pad=10 + 14 * rows)
