"""`localiser map deduplicate`: landmarks that are there twice become one."""

from __future__ import annotations

import typer

from localiser.commands.map.options import Force, MapFile, MapOut, require_writable
from localiser.commands.options import Quiet


def deduplicate(map_file: MapFile, out: MapOut, force: Force = False, quiet: Quiet = False) -> None:
    """Merge the landmarks of a MAP that are there twice, as `map check` lists them."""
    from localiser.mapping import deduplicated
    from localiser.storage import read_map, write_map

    require_writable(out, overwrite=force)
    landmark_map = read_map(map_file)
    smaller, gone = deduplicated(landmark_map)
    write_map(smaller, out)
    if not quiet:
        for kept, other in gone:
            typer.echo(f"{other} is now part of {kept}")
        typer.echo(f"{len(smaller)} landmarks in {out}, {len(gone)} fewer than in {map_file}")
