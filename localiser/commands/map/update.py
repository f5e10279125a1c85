"""`localiser map update`: bring a map up to date with a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.map.options import MapFile, NewMap, Within, edges_with_progress, parse_poses, read_one_map
from localiser.commands.options import BagCamera, ConfigFile, Overrides, Topics, is_quiet, open_with_settings


def update(
    map_file: MapFile,
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A log of the building as it is now.")],
    out: NewMap,
    poses: Annotated[
        str, typer.Option(metavar="truth|FILE|odometry", help="Where the robot was, in the map's frame.")
    ] = "truth",
    within: Within = 0.1,
    topics: Topics = None,
    camera: BagCamera = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
) -> None:
    """Bring a MAP up to date with a LOG: landmarks that are gone are dropped, new ones added, the others refined."""
    from localiser.mapping import build_map, update_map
    from localiser.storage import require_new_file, write_map

    require_new_file(out)
    old = read_one_map(map_file)
    recorded, settings = open_with_settings(log, config, overrides, topics, camera)
    track, source = parse_poses(poses)
    built = build_map(recorded, track, settings, edges_of=lambda log: edges_with_progress(log, settings), source=source)
    changed = update_map(old, built, recorded.camera, settings.mapping.tracks.found, within)
    write_map(changed.landmark_map, out)
    if not is_quiet():
        typer.echo(f"{len(changed.landmark_map)} landmarks in {out}; {changed.again} were seen again")
        typer.echo(f"Gone: {', '.join(map(str, changed.gone)) or 'none'}")
        typer.echo(f"New: {', '.join(map(str, changed.new)) or 'none'}")
