"""All tables of the paper."""

from __future__ import annotations

from dataclasses import dataclass

from paper import equations, results
from paper.motions import Measured, measure
from paper.sheet import Sheet


@dataclass(frozen=True, slots=True, eq=False)
class Reproduction:
    """The tables, in the order of the paper, and what they were measured from."""

    sheets: tuple[Sheet, ...]
    found: Measured


def reproduce(places: int, seed: int) -> Reproduction:
    """Compute and measure everything; the same seed gives the same figures."""
    found = measure(places, seed)
    sheets = (
        equations.table_1(),
        equations.steepest_slope(),
        equations.one_pixel(),
        results.three_turns(found),
        results.rotations(found),
        equations.explanations(),
        results.translations(found),
    )
    return Reproduction(tuple(sheet for sheet in sheets if sheet is not None), found)
