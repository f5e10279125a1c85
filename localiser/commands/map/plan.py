"""A floor plan's file becomes a landmark map."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from localiser.errors import InputError
from localiser.landmarks import LandmarkMap
from localiser.mapping import FloorPlan, plan_landmarks
from localiser.storage import is_plan, load_map, load_plan


def map_or_plan(path: Path) -> LandmarkMap:
    """Return the landmark map of a file, or of a floor plan where it is one. Raises InputError."""
    return map_of_plan(path)[0] if is_plan(path) else load_map(path)


def map_of_plan(path: Path) -> tuple[LandmarkMap, FloorPlan]:
    """Return the landmarks of a map_server floor plan, and the plan. Raises InputError for one without walls."""
    plan = load_plan(path)
    share = float(np.mean(plan.occupied))
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
