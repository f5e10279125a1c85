"""`localiser map check`: what is doubtful in a map, how it fits a log, and where it says too little."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.build import poses_named
from localiser.commands.map.options import Force, MapFile, Picture, PlanFile, WasAt, require_writable
from localiser.commands.options import ConfigFile, Overrides, Quiet, opened, progress, show

if TYPE_CHECKING:
    from rich.table import Table

    from localiser.landmarks import LandmarkMap
    from localiser.mapping import LogFit

_OFTEN = 10  # frames in which a landmark must be expected before its absence is worth telling
_SELDOM = 0.1  # share of them in which it is found
_ASTRAY_DEG = 0.4  # three times what edges of a good map are off
_SHOWN = 12


def check(
    map_file: MapFile,
    log: Annotated[
        Path | None, typer.Option(metavar="LOG", help="See how its edges fit; its camera looks round.")
    ] = None,
    poses: WasAt = "truth",
    camera_file: Annotated[
        Path | None, typer.Option("--camera", metavar="FILE", help="The camera that looks round, without a log.")
    ] = None,
    plan: PlanFile = None,
    out: Picture = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Tell what looks wrong with a MAP, how it fits a log, and where too little is in view."""
    from localiser.commands.map.pictures import Surroundings, draw_coverage
    from localiser.geometry import Trajectory
    from localiser.mapping import cache_folder, coverage, fit_to_log, known_poses
    from localiser.storage import read_camera, read_map, read_plan

    picture = out or map_file.with_name(f"{map_file.stem}_coverage.png")
    landmark_map, walls = read_map(map_file), read_plan(plan) if plan else None
    camera, path, fit = read_camera(camera_file) if camera_file else None, None, None
    recorded, effective = opened(log, config, [*(overrides or [])]) if log else (None, None)
    if recorded is not None:
        camera = recorded.camera
    if camera is not None:
        require_writable(picture, overwrite=force)
    if recorded is not None and effective is not None:
        named, _ = poses_named(poses)
        known = named if isinstance(named, Trajectory) else known_poses(recorded, named)
        path = known.poses
        with progress("Finding edges", len(recorded.frames), quiet) as advance:
            fit = fit_to_log(landmark_map, recorded, known, effective.edges, advance, cache_folder())
    show(suspects(landmark_map, fit))
    if fit is not None:
        typer.echo(fit.text())
    if camera is None:
        typer.echo("What is in view from where depends on the camera: --log LOG or --camera FILE shows it.")
        return
    found = coverage(landmark_map, camera)
    draw_coverage(landmark_map, found, picture, Surroundings(path, walls))
    typer.echo(found.text())
    typer.echo(f"Picture in {picture}")


def suspects(landmark_map: LandmarkMap, fit: LogFit | None) -> Table:
    """Return what looks wrong with single landmarks."""
    import numpy as np

    from localiser.evaluate import new_table
    from localiser.mapping import doubtful, duplicates

    table = new_table("What looks wrong", "", "landmarks", texts=2)
    ids = [str(name) for name in landmark_map.ids]
    pairs = duplicates(landmark_map)
    table.add_row("there twice", _some([f"{ids[i]}={ids[j]}" for i, j in pairs]))
    table.add_row("unlikely or vague", _some([ids[k] for k in doubtful(landmark_map)]))
    if fit is not None:
        share = fit.found / np.maximum(fit.expected, 1)
        missing = np.flatnonzero((fit.expected >= _OFTEN) & (share < _SELDOM))
        astray = np.flatnonzero((fit.found >= _OFTEN) & (np.rad2deg(fit.rms_rad) > _ASTRAY_DEG))
        table.add_row("hardly ever found where in view", _some([ids[k] for k in missing]))
        table.add_row("found off its place", _some([f"{ids[k]} ({np.rad2deg(fit.rms_rad[k]):.1f}°)" for k in astray]))
    return table


def _some(names: list[str]) -> str:
    more = f", and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more if names else "none"
