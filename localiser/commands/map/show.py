"""`localiser map show`: a map as a picture and as a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.options import MapFile, Picture, picture_path, summary_table
from localiser.commands.options import is_quiet
from localiser.commands.options import show as print_table

if TYPE_CHECKING:
    from localiser.geometry import Array


def show(
    map_file: MapFile,
    path: Annotated[
        Path | None,
        typer.Option(metavar="LOG|FILE", help="Draw a path: of a log (its truth, else odometry), or a trajectory."),
    ] = None,
    plan: Annotated[
        Path | None, typer.Option(metavar="PLAN", help="Draw the walls of a floor plan of map_server (YAML).")
    ] = None,
    out: Picture = None,
) -> None:
    """Draw a MAP from above, with the certainty of every landmark, and print what is known of them."""
    from localiser.commands.map.pictures import draw_map
    from localiser.mapping import known_poses
    from localiser.storage import open_log, read_map, read_plan, read_poses

    landmark_map = read_map(map_file)
    picture = picture_path(out, map_file, "map")
    driven: Array | None = None
    if path is not None and path.suffix in (".tum", ".txt", ".csv"):
        driven = read_poses(path).poses
    elif path is not None:
        log = open_log(path)
        driven = known_poses(log, "odometry" if log.groundtruth is None else "truth").poses
    draw_map(landmark_map, picture, driven, read_plan(plan) if plan else None)
    if not is_quiet():
        print_table(summary_table(landmark_map))
        typer.echo(f"Picture in {picture}")
