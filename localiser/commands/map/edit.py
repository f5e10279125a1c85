"""`localiser map add|remove|move`: landmarks edited by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.options import Force, MapFile, MapOut, require_writable
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.geometry import Array

Height = Annotated[float | None, typer.Option(min=-10.0, max=1000.0, metavar="M", help="Height above the floor.")]
_FARTHEST_M = 1e6


def add(
    map_file: MapFile,
    at: Annotated[str, typer.Option(metavar="x,z", help="Where it stands, in metres.")],
    out: MapOut,
    name: Annotated[str | None, typer.Option("--id", metavar="ID", help="Its name; by default a number.")] = None,
    bottom: Height = None,
    top: Height = None,
    force: Force = False,
) -> None:
    """Add a landmark to a MAP."""
    from localiser.mapping import added
    from localiser.storage import read_map, write_map

    require_writable(out, overwrite=force)
    point = parse_point(at, "--at")
    write_map(added(read_map(map_file), point, name, bottom, top), out)


def remove(
    map_file: MapFile,
    ids: Annotated[list[str], typer.Argument(metavar="ID…", help="Landmarks to leave out.")],
    out: MapOut,
    force: Force = False,
) -> None:
    """Remove landmarks from a MAP."""
    from localiser.mapping import removed
    from localiser.storage import read_map, write_map

    require_writable(out, overwrite=force)
    write_map(removed(read_map(map_file), ids), out)


def move(
    map_file: MapFile,
    name: Annotated[str, typer.Argument(metavar="ID", help="The landmark to move.")],
    to: Annotated[str, typer.Option(metavar="x,z", help="Where it stands, in metres.")],
    out: MapOut,
    force: Force = False,
) -> None:
    """Move a landmark of a MAP."""
    from localiser.mapping import moved
    from localiser.storage import read_map, write_map

    require_writable(out, overwrite=force)
    write_map(moved(read_map(map_file), name, parse_point(to, "--to")), out)


def parse_point(text: str, field: str) -> Array:
    """Return the point (2,) that `x,z` in metres stands for. Raises InputError."""
    import numpy as np

    try:
        x, z = (float(part) for part in text.split(","))
    except ValueError:
        x = z = np.nan
    if not (abs(x) <= _FARTHEST_M and abs(z) <= _FARTHEST_M):
        raise InputError(f"expected x,z in metres, found {text!r}", field=field)
    return np.array([x, z])
