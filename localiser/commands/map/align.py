"""`localiser map align`: find the transformation between two maps."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.options import Force, Within, require_writable
from localiser.commands.options import show

if TYPE_CHECKING:
    from rich.table import Table

    from localiser.landmarks import LandmarkMap
    from localiser.mapping import Alignment

_UNCLEAR = 0.9
"""Share of the matches that another alignment has, above which nobody can tell which of the two is right."""


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
    import numpy as np

    from localiser.commands.map.plan import map_or_plan
    from localiser.storage import read_map, write_map

    require_writable(out, overwrite=force)
    one, other = map_or_plan(first), read_map(second)
    alignment = best_fit(one, other, within, similarity=scale)
    (x, z, heading), residual = alignment.pose, alignment.residual_m
    typer.echo(
        f"{len(alignment.pairs)} of {len(one)} and {len(other)} landmarks match: moved by x {x:.3f} m, z {z:.3f} m, "
        f"turned by {math.degrees(heading):.2f}°, scaled by {alignment.scale:.4f}\n"
        f"They lie {np.median(residual):.3f} m apart (median), {np.sqrt(np.mean(residual**2)):.3f} m (RMSE), "
        f"at most {residual.max():.3f} m"
    )
    show(_fit_table(one, other, alignment))
    if out is not None:
        write_map(alignment.moved(other), out)


def best_fit(first: LandmarkMap, second: LandmarkMap, within_m: float, *, similarity: bool) -> Alignment:
    """Return how the second map lies over the first; warn when another alignment is nearly as good.

    Raises InputError when they do not fit.
    """
    from localiser.errors import InputError
    from localiser.mapping import align as best_alignment

    try:
        alignment = best_alignment(first.points, second.points, within_m, similarity=similarity)
    except ValueError as error:
        raise InputError(f"{error}: the maps do not fit") from None
    if alignment.alternative >= _UNCLEAR:
        share = f"{100 * alignment.alternative:.0f} %"
        text = (
            f"Another alignment matches {share} as many landmarks: the building may look like itself, turned or moved."
        )
        typer.secho(text, fg="yellow", err=True)
    return alignment


def _fit_table(first: LandmarkMap, second: LandmarkMap, alignment: Alignment) -> Table:
    """Return the landmarks that match and lie farthest apart."""
    import numpy as np

    from localiser.evaluate import new_table

    table = new_table("Farthest apart", "first", "second", "apart, m", texts=0)
    for k in np.argsort(-alignment.residual_m, kind="stable")[:10]:
        one, other = alignment.pairs[k]
        table.add_row(str(first.ids[one]), str(second.ids[other]), f"{alignment.residual_m[k]:.3f}")
    return table
