"""`localiser map merge`: two maps as one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from localiser.commands.map.align import aligned
from localiser.commands.map.options import Force, MapOut, Within, require_writable
from localiser.commands.options import Quiet
from localiser.errors import InputError


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
    from localiser.commands.map.plan import map_or_plan
    from localiser.mapping import fused, same_in_both
    from localiser.storage import read_map, write_map

    require_writable(out, overwrite=force)
    one, other = map_or_plan(first), read_map(second)
    if find_frame:
        other = aligned(one, other, within, similarity=False).moved(other)
    pairs = same_in_both(one, other, within)
    if not len(pairs):
        raise InputError(
            f"expected landmarks of one map within {within:g} m of the other's, found none: "
            "are they in one frame? `localiser map align` finds out"
        )
    whole, both = fused(one, other, pairs), len(pairs)
    write_map(whole, out)
    if not quiet:
        typer.echo(
            f"{len(whole)} landmarks in {out}: {both} of both maps, {len(one) - both} of the first alone, "
            f"{len(other) - both} of the second alone"
        )
