"""`localiser map align` and `merge`: how two maps lie over each other, and two as one, or the duplicates of one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.options import NewMap, Within, read_one_map
from localiser.commands.options import is_quiet, show, warn
from localiser.errors import InputError

if TYPE_CHECKING:
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
    within: Within = 0.15,
) -> None:
    """Find how map B lies over map A, when nobody says which landmark is which; print what does not fit."""
    import numpy as np

    from localiser.commands.map.plan import map_or_plan
    from localiser.evaluate import new_table
    from localiser.storage import require_new_file, write_map

    if out is not None:
        require_new_file(out)
    one, other = map_or_plan(first), read_one_map(second)
    alignment = best_fit(one, other, within)
    (x, z, heading), residual = alignment.pose, alignment.residual_m
    typer.echo(
        f"{len(alignment.pairs)} of {len(one)} and {len(other)} landmarks match: moved by x {x:.3f} m, z {z:.3f} m, "
        f"turned by {np.rad2deg(heading):.2f}°\n"
        f"They lie {np.median(residual):.3f} m apart (median), {np.sqrt(np.mean(residual**2)):.3f} m (RMSE), "
        f"at most {residual.max():.3f} m"
    )
    table = new_table("Farthest apart", "first", "second", "apart, m", texts=0)
    for k in np.argsort(-residual, kind="stable")[:10]:
        i, j = alignment.pairs[k]
        table.add_row(str(one.ids[i]), str(other.ids[j]), f"{residual[k]:.3f}")
    show(table)
    if out is not None:
        write_map(alignment.moved(other), out)


def best_fit(first: LandmarkMap, second: LandmarkMap, within_m: float) -> Alignment:
    """Return how the second map lies over the first; warn when another alignment is nearly as good.

    Raises InputError when they do not fit.
    """
    from localiser.mapping import align as best_alignment

    try:
        alignment = best_alignment(first.points, second.points, within_m)
    except ValueError as error:
        raise InputError(f"{error}: the maps do not fit") from None
    if alignment.alternative >= _UNCLEAR:
        share = f"{100 * alignment.alternative:.0f} %"
        warn(
            f"Another alignment matches {share} as many landmarks: the building may look like itself, turned or moved."
        )
    return alignment


def merge(
    first: Annotated[
        Path,
        typer.Argument(metavar="PLAN", help="The map, or the floor plan of ROS map_server, whose frame and ids stay."),
    ],
    second: Annotated[
        Path | None,
        typer.Argument(
            metavar="LOG-MAP",
            help="The map that refines it, as built from a log; without it, the first's own duplicates become one.",
        ),
    ] = None,
    *,
    out: NewMap,
    find_frame: Annotated[
        bool, typer.Option("--align", help="The maps have frames of their own: align first.")
    ] = False,
    within: Within = 0.15,
) -> None:
    """Refine a PLAN by a LOG-MAP: landmarks of both are fused by their covariances, the others are kept.

    Of one map alone, the landmarks that `map check` lists as there twice become one.
    """
    from localiser.commands.map.plan import map_or_plan
    from localiser.mapping import common_landmarks, fuse_maps, merge_duplicates
    from localiser.storage import require_new_file, write_map

    require_new_file(out)
    one = map_or_plan(first)
    if second is None:
        if find_frame:
            raise InputError("expected two maps, found one", field="--align")
        whole, gone = merge_duplicates(one)
        pairs = "; ".join(f"{other} is part of {kept}" for kept, other in gone)
        text = f"{len(gone)} were there twice" + (f": {pairs}" if gone else "")
    else:
        other = read_one_map(second)
        if find_frame:
            other = best_fit(one, other, within).moved(other)
        common = common_landmarks(one, other, within)
        if not (both := len(common)):
            raise InputError(
                f"expected landmarks of one map within {within:g} m of the other's, found none: "
                "are they in one frame? `localiser map align` finds out"
            )
        whole = fuse_maps(one, other, common)
        text = f"{both} of both maps, {len(one) - both} of the first alone, {len(other) - both} of the second alone"
    write_map(whole, out)
    if not is_quiet():
        typer.echo(f"{len(whole)} landmarks in {out}: {text}")
