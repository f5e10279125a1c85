"""Lay maps over each other: how they fit, and both as one."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from localiser.errors import InputError
from localiser.geometry import map_from_robot
from localiser.landmarks import LandmarkMap
from localiser.mapping import Alignment, agreeing, align, fused, matches

if TYPE_CHECKING:
    from rich.table import Table

_RIVAL = 0.9
"""Share of the matches that another alignment has, above which nobody can tell which of the two is right."""


def aligned(first: LandmarkMap, second: LandmarkMap, within_m: float, *, similarity: bool) -> Alignment:
    """Return how the second map lies over the first. Raises InputError when they do not fit."""
    try:
        return align(first.points, second.points, within_m, similarity=similarity)
    except ValueError as error:
        raise InputError(f"{error}: the maps do not fit") from None


def moved_onto(alignment: Alignment, second: LandmarkMap) -> LandmarkMap:
    """Return the second map in the frame of the first; heights are left as they are."""
    turn = map_from_robot(np.array([0.0, 0.0, alignment.pose[2]]), alignment.scale * np.eye(2)).T
    return replace(second, points=alignment.apply(second.points), cov=turn @ second.cov @ turn.T)


def warning(alignment: Alignment) -> str | None:
    """Return what to say when another alignment is nearly as good."""
    if alignment.rival < _RIVAL:
        return None
    share = f"{100 * alignment.rival:.0f} %"
    return f"Another alignment matches {share} as many landmarks: the building may look like itself, turned or moved."


def alignment_text(first: LandmarkMap, second: LandmarkMap, alignment: Alignment) -> str:
    """Return how the second map was moved, and how well it fits."""
    x, z, heading = alignment.pose
    residual = alignment.residual_m
    return (
        f"{len(alignment.pairs)} of {len(first)} and {len(second)} landmarks match: moved by x {x:.3f} m, z {z:.3f} m, "
        f"turned by {np.rad2deg(heading):.2f}°, scaled by {alignment.scale:.4f}\n"
        f"They lie {np.median(residual):.3f} m apart (median), {np.sqrt(np.mean(residual**2)):.3f} m (RMSE), "
        f"at most {residual.max():.3f} m"
    )


def alignment_table(first: LandmarkMap, second: LandmarkMap, alignment: Alignment) -> Table:
    """Return the landmarks that match and lie farthest apart."""
    from rich.table import Table

    table = Table(title="Farthest apart")
    for name in ("first", "second", "apart, m"):
        table.add_column(name, justify="right")
    for k in np.argsort(-alignment.residual_m, kind="stable")[:10]:
        one, other = alignment.pairs[k]
        table.add_row(str(first.ids[one]), str(second.ids[other]), f"{alignment.residual_m[k]:.3f}")
    return table


def merged(first: LandmarkMap, second: LandmarkMap, within_m: float) -> tuple[LandmarkMap, int]:
    """Return both maps, in one frame, as one, and how many landmarks were in both.

    Landmarks are one when they are each other's nearest, within `within_m`, and do not contradict each other.
    Raises InputError when none is: then the maps are hardly in the same frame.
    """
    pairs = matches(first.points, second.points, within_m)
    pairs = pairs[agreeing(first, second, pairs, within_m)]
    if not len(pairs):
        raise InputError(
            f"expected landmarks of one map within {within_m:g} m of the other's, found none: "
            "are they in one frame? `localiser map align` finds out"
        )
    return fused(first, second, pairs), len(pairs)
