"""`localiser map update`: keep a map true."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.map.edit_arguments import Force, MapFile, MapOut, Within
from localiser.commands.options import BagCamera, ConfigFile, Overrides, Quiet, Topics, opened, progress, topics_by_role


def update(
    map_file: MapFile,
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A log of the building as it is now.")],
    out: MapOut,
    poses: Annotated[
        str, typer.Option(metavar="truth|FILE|odometry", help="Where the robot was, in the map's frame.")
    ] = "truth",
    within: Within = 0.1,
    topics: Topics = None,
    camera: BagCamera = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Bring a MAP up to date with a LOG: landmarks that are gone are dropped, new ones added, the others refined."""
    from localiser.commands.map import build as map_build
    from localiser.commands.map.update import keep_old, updated
    from localiser.storage import load_map, save_map

    map_build.require_writable(out, overwrite=force)
    old = load_map(map_file)
    recorded, effective = opened(log, config, [*(overrides or [])], topics=topics_by_role(topics), camera=camera)
    with progress("Finding edges", len(recorded.frames), quiet) as advance:
        built = map_build.build_map(recorded, poses, effective, advance)
    changed = updated(old, built, recorded.camera, effective, within)
    kept = keep_old(map_file) if out.resolve() == map_file.resolve() else None
    save_map(changed.landmark_map, out)
    if not quiet:
        if kept is not None:
            typer.echo(f"The map as it was is {kept}")
        typer.echo(f"{len(changed.landmark_map)} landmarks in {out}; {changed.again} were seen again")
        typer.echo(f"Gone: {', '.join(map(str, changed.gone)) or 'none'}")
        typer.echo(f"New: {', '.join(map(str, changed.new)) or 'none'}")
