"""The table of benchmarks/edges.py. Nothing in it is left to chance: whatever gets worse is a loss.

Figures are rounded to one digit more than the table has, so that another order of summation is none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from figures.measures import Measure
from figures.program import ROOT
from figures.tasks import Task, Values

if TYPE_CHECKING:
    from edge_scenes import Scene

DETECTORS = ("columns", "lsd")
OF_EACH = {"recall": Measure("down"), "precision": Measure("down"), "median error °": Measure("up")}
MEASURES = {f"{detector} {name}": measure for detector in DETECTORS for name, measure in OF_EACH.items()}
SIMULATED = 20  # images of each class


def tasks(data: Path) -> list[Task]:
    """Return what is measured. data: folder of the images that do not ship."""
    kinds: dict[str, tuple[Callable[[], Values], Path | None]] = {
        name: (partial(table, "simulated", name, SIMULATED), None) for name in ("clean", "moderate", "hard")
    }
    kinds |= {
        name: (partial(table, "rendered", name, every), None) for name, every in (("corridor", 5), ("office", 10))
    }
    kinds["house"] = (partial(table, "house", data / "house", 4), data / "house")
    kinds["york urban"] = (partial(table, "york_urban", data / "york_urban", 1), data / "york_urban")
    return [Task("edges", name, 0, work, needs) for name, (work, needs) in kinds.items()]


def table(source: str, which: str | Path, count: int) -> Values:
    """Return the rows of one kind of images."""
    import edges

    scores = edges.judge(_scenes(source, which, count), list(DETECTORS), [], None)
    values: Values = {}
    for detector, score in scores.items():
        values[f"{detector} recall"] = round(score.recall, 4)
        values[f"{detector} precision"] = round(score.precision, 4)
        values[f"{detector} median error °"] = round(score.median_error_deg, 5)
    return values


def _scenes(source: str, which: str | Path, count: int) -> Iterable[Scene]:
    """Return the images; count: how many, or every how many."""
    import edge_data
    import edge_scenes

    if source == "simulated":
        return edge_scenes.simulated(edge_scenes.DIFFICULTIES[str(which)], count, 0)
    if source == "rendered":
        return edge_data.rendered(ROOT / "configs" / "worlds" / f"{which}.yaml", count)
    return edge_data.york_urban(Path(which)) if source == "york_urban" else edge_data.house(Path(which), count)
