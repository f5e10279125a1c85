"""All groups of figures, and how the values of a group's seeds become figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from figures import detection, hashes, instructions, limit, speed
from figures.compare import Figure, Key, Value
from figures.measures import Measure, tolerance
from figures.tasks import Task, Values

SEEDS = 20  # of the baseline
DIGITS = 6  # of a value: as many as metrics.json has


@dataclass(frozen=True, slots=True)
class Group:
    """Figures that are measured together.

    tasks: from the folder of data and how many seeds. measures: what each figure means. check_seeds, seeds: of a check
    and of the baseline. alone: whether nothing may run beside it. portable: whether its figures are the same, but for
    chance, with another processor or other libraries. by_hand: whether it is measured only where it is asked for.
    """

    tasks: Callable[[Path, int], Sequence[Task]]
    measures: Mapping[str, Measure]
    check_seeds: int = 1
    seeds: int = 1
    alone: bool = False
    portable: bool = False
    by_hand: bool = False

    def figure(self, measure: str, samples: Sequence[Value]) -> Figure:
        """Return a figure of the baseline from its values with all seeds."""
        value = self.value(measure, samples)
        if isinstance(value, str):
            return Figure(value, "change")
        means, numbers = self.measures[measure], [float(one) for one in samples]
        allowed = max(tolerance(means, numbers, self.checked(len(numbers))), means.least * float(value))
        return Figure(value, means.loss, float(f"{allowed:.3g}"), means.over, numbers)

    def checked(self, measured: int) -> int:
        """Return how many seeds a check takes, where the baseline has `measured`: both sum up the same seeds."""
        return min(self.check_seeds, measured)

    def value(self, measure: str, samples: Sequence[Value]) -> Value:
        """Return the figure over the seeds of a check."""
        first = samples[0]
        return first if isinstance(first, str) else rounded(self.measures[measure].of(samples[: self.check_seeds]))


GROUPS = {
    "hashes": Group(lambda data, _: hashes.tasks(data), hashes.MEASURES),
    "efficiency": Group(lambda _, seeds: limit.tasks(seeds), limit.MEASURES, SEEDS, SEEDS, portable=True),
    "edges": Group(lambda data, _: detection.tasks(data), detection.MEASURES),
    "speed": Group(lambda _, seeds: speed.tasks(seeds), speed.MEASURES, 3, SEEDS, alone=True),
    "instructions": Group(lambda _, seeds: instructions.tasks(seeds), instructions.MEASURES, seeds=2, by_hand=True),
}


def rounded(value: float) -> float:
    """Return the value with as many digits as the file has, so that the order of a sum makes no difference."""
    return float(f"{value:.{DIGITS}g}")


def samples_of(results: Sequence[tuple[Task, Values]]) -> dict[Key, list[Value]]:
    """Return the values of every figure in the order of seeds."""
    samples: dict[Key, list[Value]] = {}
    for task, values in sorted(results, key=lambda result: (result[0].case, result[0].seed)):
        for measure, value in values.items():
            kept = value if isinstance(value, str) else rounded(value)
            samples.setdefault((task.group, task.case, measure), []).append(kept)
    return samples
