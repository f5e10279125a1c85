"""`localiser map check`: what is there twice in a map, and how many landmarks are in view from where."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.map.options import MapFile, Picture, picture_path

_SHOWN = 12


def check(
    map_file: MapFile,
    log: Annotated[Path | None, typer.Option(metavar="LOG", help="A log whose camera looks round.")] = None,
    camera_file: Annotated[
        Path | None, typer.Option("--camera", metavar="FILE", help="The camera that looks round, without a log.")
    ] = None,
    out: Picture = None,
) -> None:
    """Tell which landmarks of a MAP are there twice, and from where too few are in view."""
    from localiser.commands.map.pictures import draw_coverage
    from localiser.mapping import coverage, duplicates
    from localiser.storage import open_log, read_camera, read_map

    landmark_map = read_map(map_file)
    camera = open_log(log).camera if log else read_camera(camera_file) if camera_file else None
    twice = [f"{landmark_map.ids[i]}={landmark_map.ids[j]}" for i, j in duplicates(landmark_map)]
    more = f", and {len(twice) - _SHOWN} more" if len(twice) > _SHOWN else ""
    typer.echo(f"There twice: {', '.join(twice[:_SHOWN]) + more if twice else 'none'}")
    if camera is None:
        typer.echo("What is in view from where depends on the camera: --log LOG or --camera FILE shows it.")
        return
    picture = picture_path(out, map_file, "coverage")
    found = coverage(landmark_map, camera)
    draw_coverage(landmark_map, found, picture)
    typer.echo(found.text())
    typer.echo(f"Picture in {picture}")
