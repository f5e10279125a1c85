"""The layout (Rerun's blueprint): what is shown where when a recording is opened."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun.blueprint as rrb

from localiser.geometry import Array
from localiser.view import paths
from localiser.view.paths import Context

BACKGROUND = (17, 20, 26, 255)
SHOWN_FIRST = 3
"""Charts that are seen at once: more cannot be read on a screen of 1440 × 713."""
ELEVATION_RAD = np.deg2rad(62.0)
"""Of the eye over the floor: high enough for a plan, low enough that vertical edges have a length."""
STAGES_SHOWN_MS = (0.0, 120.0)
"""The first image fills tables for the whole run; on a scale that holds it too, all others would lie on the floor."""


def blueprint(context: Context) -> rrb.Blueprint:
    """Return the layout: the world large on the left, the image and some charts beside it, more and text in tabs."""
    plots = _plots(context)
    first = rrb.Vertical(*plots[:SHOWN_FIRST], name="Charts")
    columns = rrb.TextLogColumns(timeline_columns=[paths.FRAME], text_log_columns=["LogLevel", "Body"])
    text = rrb.TextLogView(origin=paths.TEXT, name="Messages", columns=columns)
    charts = rrb.Tabs(first, rrb.Vertical(*plots[SHOWN_FIRST:], name="More charts"), text, active_tab=0)
    beside = rrb.Vertical(_image(context), charts, row_shares=[6, 11]) if context.images else charts
    return rrb.Blueprint(
        rrb.Horizontal(_world(context), beside, column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline=paths.FRAME),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )


def _world(context: Context) -> rrb.Spatial3DView:
    target, position = _eye(context)
    span: dict[str, Any] = {"start": rrb.TimeRangeBoundary.infinite(), "end": rrb.TimeRangeBoundary.cursor_relative()}
    so_far = rrb.VisibleTimeRanges([rrb.VisibleTimeRange(line, **span) for line in (paths.FRAME, paths.TIME)])
    return rrb.Spatial3DView(
        origin=paths.WORLD,
        contents=["$origin/**", f"- /{paths.OVERLAY}/**"],
        name=context.name or "World",
        background=BACKGROUND,
        line_grid=rrb.LineGrid3D(visible=True, spacing=1.0, color=(255, 255, 255, 10), stroke_width=0.6),
        eye_controls=rrb.EyeControls3D(position=position, look_target=target, eye_up=(0.0, 1.0, 0.0)),
        overrides=dict.fromkeys(paths.TRAILS, so_far),
    )


def _eye(context: Context) -> tuple[Array, Array]:
    """Return target and position (3,) of an eye that has map and truth in sight, map -z up on the screen."""
    points = context.landmark_map.points
    if context.truth is not None:
        points = np.concatenate([points, context.truth.poses[:, :2]])
    low, high = points.min(axis=0), points.max(axis=0)
    width, depth = np.maximum(high - low, 2.0)
    # Rerun's field of view is 55°, the panel about square: the near edge of the floor just fits, across and along.
    distance = max(width / 1.1, 0.85 * depth) + depth / 4
    target = np.array([(low + high)[0] / 2, 0.0, (low + high)[1] / 2])
    return target, target + distance * np.array([0.0, np.sin(ELEVATION_RAD), np.cos(ELEVATION_RAD)])


def _image(context: Context) -> rrb.Spatial2DView:
    camera = context.camera
    bounds = rrb.VisualBounds2D(x_range=[-0.5, camera.width - 0.5], y_range=[-0.5, camera.height - 0.5])
    return rrb.Spatial2DView(origin=paths.CAMERA, name="Image", background=BACKGROUND, visual_bounds=bounds)


def _plots(context: Context) -> list[rrb.TimeSeriesView]:
    what = "error and 3σ" if context.truth is not None else "3σ"
    titles = {
        paths.ERROR: f"Position {what}, m",
        paths.P_CORRECT: "Probability of being right",
        paths.COUNTS: "Edges",
        paths.HEADING: f"Heading {what}, °",
        paths.ESS: "Effective sample size",
        paths.STAGES: "Time, ms",
    }
    axes = {
        paths.P_CORRECT: rrb.ScalarAxis(range=(-0.05, 1.05)),  # else a fall by a millionth fills the plot
        paths.STAGES: rrb.ScalarAxis(range=STAGES_SHOWN_MS),
    }
    single = (paths.P_CORRECT, paths.ESS)  # their titles say it all
    return [
        rrb.TimeSeriesView(
            origin=path,
            name=title,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=path not in single),
            axis_y=axes.get(path),
        )
        for path, title in titles.items()
    ]
