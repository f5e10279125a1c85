"""`localiser map plan`: a floor plan's file becomes a landmark map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.options import NewMap, read_one_map
from localiser.commands.options import is_quiet
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.landmarks import LandmarkMap
    from localiser.mapping import FloorPlan


def plan(
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help="Floor plan: map_server's YAML, beside its PGM or PNG.")],
    out: NewMap,
) -> None:
    """Turn the corners of walls, jambs and pillars of a floor PLAN into landmarks."""
    from localiser.storage import require_new_file, write_map

    require_new_file(out)
    landmark_map, drawn = map_of_plan(plan)
    write_map(landmark_map, out)
    if not is_quiet():
        rows, columns = drawn.shape
        typer.echo(
            f"{len(landmark_map)} landmarks in {out}, from a plan of {columns * drawn.resolution_m:.1f} m × "
            f"{rows * drawn.resolution_m:.1f} m; `localiser map show {out}` draws them."
        )


def map_or_plan(path: Path) -> LandmarkMap:
    """Return the landmark map of a file, or of a floor plan where it is one. Raises InputError."""
    from localiser.storage import is_plan

    return map_of_plan(path)[0] if is_plan(path) else read_one_map(path)


def map_of_plan(path: Path) -> tuple[LandmarkMap, FloorPlan]:
    """Return the landmarks of a map_server floor plan, and the plan. Raises InputError for one without walls."""
    from localiser.mapping import plan_landmarks
    from localiser.storage import read_plan

    plan = read_plan(path)
    share = float(plan.occupied.mean())
    if not plan.occupied.any():
        raise InputError(
            "expected walls, found no pixel above occupied_thresh: are negate and the thresholds right?", path=path
        )
    if not plan.free.any():
        raise InputError(
            f"expected floor that is free, found none and {100 * share:.0f} % walls: "
            "are negate and the thresholds right?",
            path=path,
        )
    try:
        landmark_map = plan_landmarks(plan, path.stem, f"plan {path.name}")
    except ValueError as error:
        raise InputError(f"{error}: this is the picture of no building", path=path) from None
    if not len(landmark_map):
        raise InputError(
            f"expected corners of walls or pillars beside free floor, found none: {100 * share:.2g} % of the pixels "
            "are walls",
            path=path,
        )
    return landmark_map, plan
