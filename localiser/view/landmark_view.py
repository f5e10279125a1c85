"""A map, for Rerun: every landmark with what is known of it; and what looks like another place."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from localiser.camera import Camera, Mount
from localiser.landmarks import LandmarkMap, Quality
from localiser.view import palette, world
from localiser.view.context import Context
from localiser.view.layout import BACKGROUND, ELEVATION_RAD
from localiser.view.mapping import ELLIPSES, PLACES, ellipses
from localiser.view.paths import WORLD
from localiser.view.recorder import new_stream
from localiser.view.recording_file import RecordingFile

if TYPE_CHECKING:
    from localiser.mapping import Aliasing

ALIKE = f"{WORLD}/building/alike"
FEET = f"{WORLD}/building/feet"
_NOBODY = Camera(1, 1, 1.0, 1.0, 0.0, 0.0, Mount(tilt_rad=0.0, height_m=0.5))
"""A map has no camera; landmarks of unknown height are drawn as those are that one so high looks at: a metre tall."""


def record_map(path: Path, landmark_map: LandmarkMap) -> None:
    """Write a map to a `.rrd` file: landmarks as bright as they are likely, their 95 % ellipses, figures on hovering.

    Raises OutputError where it cannot be written.
    """
    context = Context(landmark_map.name, _NOBODY, landmark_map, images=False, application="localiser map")
    stream = new_stream(context)
    file = RecordingFile(path, stream, layout(landmark_map))
    quality = landmark_map.quality or Quality.unknown(len(landmark_map))
    likely = np.where(np.isnan(quality.existence), 1.0, quality.existence)
    colours = np.tile(np.array(palette.MATCHED, dtype=np.uint8), (len(landmark_map), 1))
    colours[:, :3] = colours[:, :3] * (0.25 + 0.75 * likely[:, None])
    stream.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
    strips = context.landmark_ends.astype(np.float32)
    stream.log(PLACES, rr.LineStrips3D(strips, colors=colours, radii=rr.Radius.ui_points(1.0)), static=True)
    feet = world.at_height(landmark_map.points, 0.02)
    labels = _labels(landmark_map, quality)
    stream.log(FEET, rr.Points3D(feet, colors=colours, radii=0.02, labels=labels, show_labels=False), static=True)
    known = np.isfinite(landmark_map.cov).all(axis=(1, 2))
    stream.log(ELLIPSES, ellipses(landmark_map.points[known], landmark_map.cov[known]), static=True)
    file.end()


def _labels(landmark_map: LandmarkMap, quality: Quality) -> list[str]:
    """Return for each landmark (L) its name and what is known of it."""
    sigma_cm = 100 * np.sqrt(np.trace(landmark_map.cov, axis1=1, axis2=2) / 2)
    figures = (
        ("1σ {:.2f} cm", sigma_cm),
        ("{:.0f} images", quality.sightings),
        ("{:.0f}° of parallax", np.rad2deg(quality.parallax_rad)),
        ("p = {:.2f}", quality.existence),
    )
    return [
        ", ".join([str(name), *(form.format(values[k]) for form, values in figures if np.isfinite(values[k]))])
        for k, name in enumerate(landmark_map.ids)
    ]


def record_aliasing(path: Path, camera: Camera, landmark_map: LandmarkMap, look: Aliasing) -> None:
    """Write to a `.rrd` file what looks like what, and where a landmark would help. Raises OutputError."""
    context = Context(landmark_map.name, camera, landmark_map, images=False, application="localiser map check")
    stream = new_stream(context)
    file = RecordingFile(path, stream, layout(landmark_map))
    stream.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
    stream.log(f"{WORLD}/map/unseen", world.landmarks(context.landmark_ends, palette.UNSEEN, 1.2), static=True)
    # Of weights, those near the largest are brightest; a place that looks like no other is dark.
    colours = palette.of_weights(np.append(look.share, 1.0) ** 2)[:-1]
    stream.log(ALIKE, rr.Points3D(world.at_height(look.places, 0.01), colors=colours, radii=0.08), static=True)
    poses, twins = look.examples()
    start = world.at_height(poses[:, :2], 0.05)
    arrows = rr.Arrows3D(
        origins=start, vectors=world.at_height(twins[:, :2], 0.05) - start, colors=palette.ESTIMATE, radii=0.015
    )
    stream.log(f"{ALIKE}/like", arrows, static=True)
    upright = np.stack([world.at_height(look.spots_at, height) for height in (0.0, 2.0)], axis=1).astype(np.float32)
    stream.log(f"{ALIKE}/spots", rr.LineStrips3D(upright, colors=palette.MATCHED, radii=0.03), static=True)
    file.end()


def layout(landmark_map: LandmarkMap) -> rrb.Blueprint:
    """Return the layout of a map and nothing else: the world from where all landmarks are in sight."""
    low, high = landmark_map.points.min(axis=0), landmark_map.points.max(axis=0)
    distance = 1.25 * float(np.maximum(high - low, 2.0).max())
    target = np.insert((low + high) / 2, 1, 0.0)
    position = target + distance * np.array([0.0, np.sin(ELEVATION_RAD), np.cos(ELEVATION_RAD)])
    shown = rrb.Spatial3DView(
        origin=WORLD,
        name=landmark_map.name or "Map",
        background=BACKGROUND,
        line_grid=rrb.LineGrid3D(visible=True, spacing=1.0, color=(255, 255, 255, 10), stroke_width=0.6),
        eye_controls=rrb.EyeControls3D(position=position, look_target=target, eye_up=(0.0, 1.0, 0.0)),
    )
    return rrb.Blueprint(
        shown,
        rrb.TimePanel(state="hidden"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )
