"""Check a map: what is doubtful in it, how it fits a log, and a picture of where too little is in view."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from localiser import mapping
from localiser.camera import Camera
from localiser.commands.map import lookalikes as map_alike
from localiser.commands.map.build import known_poses
from localiser.commands.map.edges import edges_of_log
from localiser.commands.map.lookalikes import Lookalikes
from localiser.config import Config
from localiser.errors import InputError
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.mapping import ENOUGH, LogFit
from localiser.storage import Log, write_bytes

if TYPE_CHECKING:
    from rich.table import Table

_STEP_M = 0.25
_MOST_STEPS = 60  # along the longer side of the building
_OFTEN = 10  # frames in which a landmark must be expected before its absence is worth telling
_SELDOM = 0.1  # share of them in which it is found
_ASTRAY_RAD = np.deg2rad(0.4)  # three times what edges of a good map are off
_SHOWN = 12


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Landmarks in view from places: x (C,), z (R,) m; share (R, C) of headings from which too few are in view."""

    x: Array
    z: Array
    share: Array


def coverage(landmark_map: LandmarkMap, camera: Camera) -> Coverage:
    """Return from where, all over the building, fewer than three landmarks are in view."""
    low, high = landmark_map.points.min(axis=0), landmark_map.points.max(axis=0)
    step = max(_STEP_M, float((high - low).max()) / _MOST_STEPS)
    count = np.ceil((high - low) / step + 2).astype(int)
    middle = (low + high) / 2
    x, z = (middle[axis] + step * (np.arange(count[axis]) - (count[axis] - 1) / 2) for axis in (0, 1))
    places = np.stack([part.ravel() for part in np.meshgrid(x, z)], axis=-1)
    few = mapping.in_view(landmark_map, camera, places) < ENOUGH
    return Coverage(x, z, few.mean(axis=1).reshape(len(z), len(x)))


def fit_to_log(landmark_map: LandmarkMap, log: Log, poses: str, config: Config, progress: Callable[[], None]) -> LogFit:
    """Return how the map fits the edges of a log with known poses. Raises InputError when it has none."""
    trajectory = known_poses(log, poses)
    t_ns = np.array([frame.t_ns for frame in log.frames], dtype=np.int64)
    inside = np.flatnonzero((t_ns >= trajectory.t_ns[0]) & (t_ns <= trajectory.t_ns[-1]))
    if not len(inside):
        raise InputError("expected poses at the times of images, found none", path=log.path, field="--poses")
    edges = edges_of_log(log, config.edges, progress)
    sightings = mapping.Sightings.from_edges([edges[k] for k in inside], log.camera)
    return mapping.log_fit(landmark_map, sightings, log.camera, trajectory.sampled(t_ns[inside]).poses)


def suspects(landmark_map: LandmarkMap, fit: LogFit | None) -> Table:
    """Return what looks wrong with single landmarks."""
    from rich.table import Table

    table = Table(title="What looks wrong")
    for name in ("", "landmarks"):
        table.add_column(name)
    ids = [str(name) for name in landmark_map.ids]
    pairs = mapping.duplicates(landmark_map)
    table.add_row("there twice", _some([f"{ids[i]}={ids[j]}" for i, j in pairs]))
    table.add_row("unlikely or vague", _some([ids[k] for k in mapping.doubtful(landmark_map)]))
    if fit is not None:
        share = fit.found / np.maximum(fit.expected, 1)
        missing = np.flatnonzero((fit.expected >= _OFTEN) & (share < _SELDOM))
        astray = np.flatnonzero((fit.found >= _OFTEN) & (fit.rms_rad > _ASTRAY_RAD))
        table.add_row("hardly ever found where in view", _some([ids[k] for k in missing]))
        table.add_row("found off its place", _some([f"{ids[k]} ({np.rad2deg(fit.rms_rad[k]):.1f}°)" for k in astray]))
    return table


def fit_text(fit: LogFit) -> str:
    """Return how well the whole map fits a log."""
    found = fit.found > 0
    rms = np.rad2deg(np.median(fit.rms_rad[found])) if found.any() else np.nan
    return (
        f"{found.sum()} of {len(found)} landmarks were seen; "
        f"{100 * fit.explained:.0f} % of the log's edges are theirs, "
        f"{rms:.2f}° (median) from where they should be"
    )


def coverage_text(found: Coverage) -> str:
    """Return how much of the building has too few landmarks."""
    return (
        f"Fewer than {ENOUGH} landmarks in view: {100 * found.share.mean():.0f} % of all places and headings; "
        f"walls, which hide more, are not counted"
    )


def save_picture(landmark_map: LandmarkMap, found: Coverage, look: Lookalikes, path: Path) -> None:
    """Draw from where too little is in view, and what looks like another place; map -z up. Raises OutputError."""
    from matplotlib.figure import Figure

    width, depth = np.ptp(found.x) + 1.0, np.ptp(found.z) + 1.0
    scale = 7.0 / max(width, depth)
    figure = Figure(figsize=(2 * max(4.0, width * scale + 1.6), max(4.0, depth * scale + 1.4)), dpi=120)
    left, right = figure.subplots(1, 2)
    half = (found.x[1] - found.x[0]) / 2 if len(found.x) > 1 else _STEP_M / 2
    extent = (found.x[0] - half, found.x[-1] + half, found.z[-1] + half, found.z[0] - half)
    all_x, all_z = np.append(look.places[:, 0], extent[:2]), np.append(look.places[:, 1], extent[2:])
    limits = (all_x.min(), all_x.max(), all_z.max(), all_z.min())
    few = left.imshow(100 * found.share, extent=extent, vmin=0, vmax=100, cmap="YlOrRd", interpolation="nearest")
    alike = map_alike.draw(look, right)
    for axes, shown, title, label in (
        (left, few, "coverage", f"headings with fewer than {ENOUGH} landmarks in view, %"),
        (right, alike, "ambiguity", "headings from which another place (arrows) looks the same, %"),
    ):
        axes.scatter(*landmark_map.points.T, s=10, color="#1f3f66", linewidths=0, label="landmark")
        axes.set(xlabel="x, m", ylabel="z, m (map −z is up)", title=f"{landmark_map.name or path.stem}: {title}")
        axes.set(xlim=limits[:2], ylim=limits[2:], aspect="equal")
        figure.colorbar(shown, ax=axes, fraction=0.046, pad=0.04).set_label(label)
    handles, labels = right.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=2, frameon=False, fontsize=8)
    figure.tight_layout(rect=(0.0, 0.04, 1.0, 1.0))
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    write_bytes(path, buffer.getvalue())


def _some(names: list[str]) -> str:
    more = f", and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more if names else "none"
