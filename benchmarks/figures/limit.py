"""How close the filter comes to the posterior Cramér–Rao bound, by benchmarks/efficiency.py."""

from __future__ import annotations

from functools import cache, partial
from itertools import product
from typing import TYPE_CHECKING, Literal

from figures.measures import Measure
from figures.tasks import Task, Values

if TYPE_CHECKING:
    from efficiency import Setting

MEASURES = {
    "rmse / bound": Measure("up", "mean"),
    "nees / 3": Measure("from one", "mean"),
    "ess": Measure("down"),
}
PARTICLES = {"known": (300, 2000), "unknown": (2000,)}


def tasks(seeds: int) -> list[Task]:
    """Return what is measured."""
    cases = [(kind, told, count) for kind, told in product(("line", "slope"), PARTICLES) for count in PARTICLES[told]]
    return [
        Task("efficiency", f"{kind} {told} {count}", seed, partial(outcome, kind, told, count, seed))
        for seed in range(seeds)
        for kind, told, count in cases
    ]


def outcome(observation: str, association: Literal["known", "unknown"], particles: int, seed: int) -> Values:
    """Return the figures of one seed."""
    import efficiency

    one = efficiency.verdict_of([efficiency.run(_setting(), observation, particles, seed, association)])
    return {"rmse / bound": one.rmse_m / one.bound_m, "nees / 3": one.nees_mean / 3, "ess": one.ess_median}


@cache
def _setting() -> Setting:
    import efficiency

    return efficiency.setting_of("corridor")
