"""All tables of the paper, and where they are written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from localiser.storage import write_bytes, write_text
from paper import equations, results
from paper.figure import figure_png
from paper.motions import Measured, measure
from paper.room import SIZES
from paper.sheet import Sheet

_HEAD = """# The paper, reproduced

T. Taylor, S. Geva, W. W. Boles, "Using Camera Tilt to Assist with Localisation", ICARA 2006. Made by `{command}`.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Reproduction:
    """The tables, in the order of the paper, and what they were measured from. command: what makes them again."""

    command: str
    sheets: tuple[Sheet, ...]
    found: Measured

    def write(self, folder: Path) -> None:
        """Write each table as CSV, all of them as paper.md, and the figure. Raises OutputError."""
        for sheet in self.sheets:
            write_text(folder / f"{sheet.name}.csv", sheet.csv())
        texts = [_HEAD.format(command=self.command), *(sheet.markdown() for sheet in self.sheets), "![](paper.png)\n"]
        write_text(folder / "paper.md", "\n".join(texts))
        write_bytes(folder / "paper.png", figure_png(self.found))


def steps(places: int) -> int:
    """Return how many times `reproduce` calls its progress."""
    return places * len(SIZES)


def reproduce(places: int, seed: int, progress: Callable[[], None]) -> Reproduction:
    """Compute and measure everything; the same seed gives the same figures. progress: `steps(places)` times."""
    found = measure(places, seed, progress)
    sheets = (
        equations.table_1(),
        equations.steepest_slope(),
        equations.one_pixel(),
        results.three_turns(found),
        results.rotations(found),
        equations.explanations(),
        results.translations(found),
    )
    command = f"localiser paper --places {places} --seed {seed}"
    return Reproduction(command, tuple(sheet for sheet in sheets if sheet is not None), found)
