"""`localiser map merge`: two maps as one, or the duplicates of one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.align import best_fit
from localiser.commands.map.options import Force, MapOut, Within, require_writable
from localiser.commands.options import is_quiet
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.landmarks import LandmarkMap


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
    out: MapOut,
    find_frame: Annotated[
        bool, typer.Option("--align", help="The maps have frames of their own: align first.")
    ] = False,
    within: Within = 0.15,
    force: Force = False,
) -> None:
    """Refine a PLAN by a LOG-MAP: landmarks of both are fused by their covariances, the others are kept.

    Of one map alone, the landmarks that `map check` lists as there twice become one.
    """
    from localiser.commands.map.plan import map_or_plan
    from localiser.storage import read_map, write_map

    require_writable(out, overwrite=force)
    one = map_or_plan(first)
    if second is None:
        if find_frame:
            raise InputError("expected two maps, found one", field="--align")
        whole, told = _merge_own(one)
    else:
        whole, told = _merge_both(one, read_map(second), within, find_frame=find_frame)
    write_map(whole, out)
    if not is_quiet():
        typer.echo(f"{len(whole)} landmarks in {out}: {told}")


def _merge_own(one: LandmarkMap) -> tuple[LandmarkMap, str]:
    from localiser.mapping import merge_duplicates

    whole, gone = merge_duplicates(one)
    pairs = "; ".join(f"{other} is part of {kept}" for kept, other in gone)
    return whole, f"{len(gone)} were there twice" + (f": {pairs}" if gone else "")


def _merge_both(one: LandmarkMap, other: LandmarkMap, within_m: float, *, find_frame: bool) -> tuple[LandmarkMap, str]:
    from localiser.mapping import common_landmarks, fuse_maps

    if find_frame:
        other = best_fit(one, other, within_m, similarity=False).moved(other)
    pairs = common_landmarks(one, other, within_m)
    both = len(pairs)
    if not both:
        raise InputError(
            f"expected landmarks of one map within {within_m:g} m of the other's, found none: "
            "are they in one frame? `localiser map align` finds out"
        )
    told = f"{both} of both maps, {len(one) - both} of the first alone, {len(other) - both} of the second alone"
    return fuse_maps(one, other, pairs), told
