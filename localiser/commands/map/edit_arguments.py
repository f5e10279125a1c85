"""`localiser map add|remove|move|export|align|merge`: maps as they are wanted."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.options import Quiet, show

MapFile = Annotated[Path, typer.Argument(metavar="MAP", help="Landmark map (YAML).")]
MapOut = Annotated[Path, typer.Option("--out", "-o", metavar="MAP", help="The map file to write; may be the same one.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what exists.")]
Within = Annotated[float, typer.Option(min=1e-3, max=10.0, metavar="M", help="How near landmarks that are one lie.")]
Height = Annotated[float | None, typer.Option(min=-10.0, max=1000.0, metavar="M", help="Height above the floor.")]


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
    from localiser.commands.map import edit as map_edit
    from localiser.commands.map.build import require_writable
    from localiser.storage import load_map, save_map

    require_writable(out, overwrite=force)
    point = map_edit.parse_point(at, "--at")
    save_map(map_edit.added(load_map(map_file), point, name, bottom, top), out)


def remove(
    map_file: MapFile,
    ids: Annotated[list[str], typer.Argument(metavar="ID…", help="Landmarks to leave out.")],
    out: MapOut,
    force: Force = False,
) -> None:
    """Remove landmarks from a MAP."""
    from localiser.commands.map import edit as map_edit
    from localiser.commands.map.build import require_writable
    from localiser.storage import load_map, save_map

    require_writable(out, overwrite=force)
    save_map(map_edit.removed(load_map(map_file), ids), out)


def move(
    map_file: MapFile,
    name: Annotated[str, typer.Argument(metavar="ID", help="The landmark to move.")],
    to: Annotated[str, typer.Option(metavar="x,z", help="Where it stands, in metres.")],
    out: MapOut,
    force: Force = False,
) -> None:
    """Move a landmark of a MAP."""
    from localiser.commands.map import edit as map_edit
    from localiser.commands.map.build import require_writable
    from localiser.storage import load_map, save_map

    require_writable(out, overwrite=force)
    save_map(map_edit.moved(load_map(map_file), name, map_edit.parse_point(to, "--to")), out)


def export(
    map_file: MapFile,
    csv: Annotated[Path | None, typer.Option(metavar="FILE", help="Write to this file, not to the screen.")] = None,
    force: Force = False,
) -> None:
    """Print a MAP as CSV, one landmark a row."""
    from localiser.commands.map.build import require_writable
    from localiser.commands.map.edit import table
    from localiser.storage import load_map, write_text

    if csv is None:
        typer.echo(table(load_map(map_file)), nl=False)
        return
    require_writable(csv, overwrite=force)
    write_text(csv, table(load_map(map_file)))


def align(
    first: Annotated[
        Path, typer.Argument(metavar="A", help="The map, or the floor plan of ROS map_server, that stays.")
    ],
    second: Annotated[Path, typer.Argument(metavar="B", help="The map that is laid over it.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="MAP", help="Write B in A's frame.")] = None,
    scale: Annotated[bool, typer.Option("--scale", help="Find the scale, too.")] = False,
    within: Within = 0.15,
    force: Force = False,
) -> None:
    """Find how map B lies over map A, when nobody says which landmark is which; print what does not fit."""
    from localiser.commands.map import merge as map_merge
    from localiser.commands.map.build import require_writable
    from localiser.commands.map.plan import map_or_plan
    from localiser.storage import load_map, save_map

    if out is not None:
        require_writable(out, overwrite=force)
    one, other = map_or_plan(first), load_map(second)
    alignment = map_merge.aligned(one, other, within, similarity=scale)
    typer.echo(map_merge.alignment_text(one, other, alignment))
    show(map_merge.alignment_table(one, other, alignment))
    if doubt := map_merge.warning(alignment):
        typer.secho(doubt, fg="yellow", err=True)
    if out is not None:
        save_map(map_merge.moved_onto(alignment, other), out)


def merge(
    first: Annotated[
        Path,
        typer.Argument(metavar="PLAN", help="The map, or the floor plan of ROS map_server, whose frame and ids stay."),
    ],
    second: Annotated[Path, typer.Argument(metavar="LOG-MAP", help="The map that refines it, as built from a log.")],
    out: MapOut,
    find_frame: Annotated[
        bool, typer.Option("--align", help="The maps have frames of their own: align first.")
    ] = False,
    within: Within = 0.15,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Refine a PLAN by a LOG-MAP: landmarks of both are fused by their covariances, the others are kept."""
    from localiser.commands.map import merge as map_merge
    from localiser.commands.map.build import require_writable
    from localiser.commands.map.plan import map_or_plan
    from localiser.storage import load_map, save_map

    require_writable(out, overwrite=force)
    one, other = map_or_plan(first), load_map(second)
    if find_frame:
        alignment = map_merge.aligned(one, other, within, similarity=False)
        if doubt := map_merge.warning(alignment):
            typer.secho(doubt, fg="yellow", err=True)
        other = map_merge.moved_onto(alignment, other)
    whole, both = map_merge.merged(one, other, within)
    save_map(whole, out)
    if not quiet:
        typer.echo(
            f"{len(whole)} landmarks in {out}: {both} of both maps, {len(one) - both} of the first alone, "
            f"{len(other) - both} of the second alone"
        )
