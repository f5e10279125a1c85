"""`localiser map check`: what is doubtful in a map, and where it says too little."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.options import Force, MapFile, Picture, PlanFile, WasAt, require_writable
from localiser.commands.map.show import path_of
from localiser.commands.options import show

if TYPE_CHECKING:
    from rich.table import Table

    from localiser.landmarks import LandmarkMap

_SHOWN = 12


def check(
    map_file: MapFile,
    log: Annotated[Path | None, typer.Option(metavar="LOG", help="Its camera looks round; its path is drawn.")] = None,
    poses: WasAt = "truth",
    camera_file: Annotated[
        Path | None, typer.Option("--camera", metavar="FILE", help="The camera that looks round, without a log.")
    ] = None,
    plan: PlanFile = None,
    out: Picture = None,
    force: Force = False,
) -> None:
    """Tell what looks wrong with a MAP, and from where too little is in view."""
    from localiser.commands.map.pictures import Surroundings, draw_coverage
    from localiser.mapping import coverage
    from localiser.storage import open_log, read_camera, read_map, read_plan

    landmark_map, walls = read_map(map_file), read_plan(plan) if plan else None
    camera = open_log(log).camera if log else read_camera(camera_file) if camera_file else None
    picture = out or map_file.with_name(f"{map_file.stem}_coverage.png")
    if camera is not None:
        require_writable(picture, overwrite=force)
    driven = path_of(log, poses)
    show(_suspects(landmark_map))
    if camera is None:
        typer.echo("What is in view from where depends on the camera: --log LOG or --camera FILE shows it.")
        return
    found = coverage(landmark_map, camera)
    draw_coverage(landmark_map, found, picture, Surroundings(driven, walls))
    typer.echo(found.text())
    typer.echo(f"Picture in {picture}")


def _suspects(landmark_map: LandmarkMap) -> Table:
    """Return what looks wrong with single landmarks."""
    from localiser.evaluate import new_table
    from localiser.mapping import doubtful, duplicates

    table = new_table("What looks wrong", "", "landmarks", texts=2)
    ids = [str(name) for name in landmark_map.ids]
    pairs = duplicates(landmark_map)
    table.add_row("there twice", _some([f"{ids[i]}={ids[j]}" for i, j in pairs]))
    table.add_row("unlikely or vague", _some([ids[k] for k in doubtful(landmark_map)]))
    return table


def _some(names: list[str]) -> str:
    more = f", and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more if names else "none"
