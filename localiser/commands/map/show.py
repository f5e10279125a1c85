"""`localiser map show`: a map as a picture and as a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.build import poses_named
from localiser.commands.map.options import Force, MapFile, Picture, PlanFile, WasAt, require_writable
from localiser.commands.options import is_quiet
from localiser.commands.options import show as print_table

if TYPE_CHECKING:
    from rich.table import Table

    from localiser.geometry import Array
    from localiser.landmarks import LandmarkMap


def show(
    map_file: MapFile,
    log: Annotated[Path | None, typer.Option(metavar="LOG", help="Draw the path of this drive.")] = None,
    poses: WasAt = "truth",
    plan: PlanFile = None,
    out: Picture = None,
    force: Force = False,
) -> None:
    """Draw a MAP from above, with the certainty of every landmark, and print what is known of them.

    The path of a drive and the walls of a floor plan are drawn too where they are given.
    """
    from localiser.commands.map.pictures import Surroundings, draw_map
    from localiser.storage import read_map, read_plan

    landmark_map = read_map(map_file)
    surroundings = Surroundings(path_of(log, poses), read_plan(plan) if plan else None)
    picture = out or map_file.with_suffix(".png")
    require_writable(picture, overwrite=force)
    draw_map(landmark_map, picture, surroundings)
    if not is_quiet():
        print_table(summary_table(landmark_map))
        typer.echo(f"Picture in {picture}")


def path_of(log: Path | None, poses: str) -> Array | None:
    """Return the poses (T, 3) of a drive, None where none is named. Raises InputError."""
    from localiser.geometry import Trajectory
    from localiser.mapping import known_poses
    from localiser.storage import open_log

    named, _ = poses_named(poses)
    if isinstance(named, Trajectory):
        return named.poses
    return known_poses(open_log(log), named).poses if log else None


def summary_table(landmark_map: LandmarkMap) -> Table:
    """Return what is known of the landmarks: median and the best and worst tenth of each figure."""
    import numpy as np

    from localiser.evaluate import new_table
    from localiser.landmarks import Quality

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
    table = new_table(f"{len(landmark_map)} landmarks", "", "10 % below", "median", "90 % below", "known")
    for name, values, form in rows:
        known = values[np.isfinite(values)]
        figures = [form.format(value) for value in np.quantile(known, (0.1, 0.5, 0.9))] if len(known) else ["–"] * 3
        table.add_row(name, *figures, str(len(known)))
    return table
