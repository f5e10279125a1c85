"""Figures as they are now beside those of the baseline."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from figures.measures import Loss, Measure

Verdict = Literal["same", "moved", "better", "LOSS", "gone", "new", "skipped", "other machine"]
LOSSES: tuple[Verdict, ...] = ("LOSS", "gone")
"""A figure that is no longer measured, although it could be, is lost too."""
Value = float | str
Key = tuple[str, str, str]
"""Group, case and measure of a figure."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of the baseline. samples: its values with all seeds that it was measured with."""

    value: Value
    loss: Loss
    tolerance: float = 0.0
    over: Literal["median", "mean"] = "median"
    samples: Sequence[float] = ()


@dataclass(frozen=True, slots=True)
class Compared:
    """A figure before and now. reason: why it was not compared."""

    key: Key
    verdict: Verdict
    before: Value | None = None
    now: Value | None = None
    tolerance: float = 0.0
    reason: str = ""


def compared(
    baseline: Mapping[Key, Figure], now: Mapping[Key, Value], skipped: Mapping[Key, str], *, same_machine: bool
) -> list[Compared]:
    """Return the verdict on every figure that is in the baseline, or was measured, or both.

    skipped: why figures of the baseline cannot be measured here. same_machine: whether bytes can be equal.
    """
    result = []
    for key, figure in baseline.items():
        if key in skipped:
            result.append(Compared(key, "skipped", figure.value, None, figure.tolerance, skipped[key]))
        elif key not in now:
            result.append(Compared(key, "gone", figure.value, None, figure.tolerance, "no longer measured"))
        else:
            verdict = verdict_of(figure, now[key], same_machine=same_machine)
            result.append(Compared(key, verdict, figure.value, now[key], figure.tolerance))
    return result + [Compared(key, "new", None, value) for key, value in now.items() if key not in baseline]


def verdict_of(figure: Figure, now: Value, *, same_machine: bool = True) -> Verdict:
    """Return whether a figure is as it was, within what chance may do, or past it."""
    if figure.value == now:
        return "same"
    if isinstance(figure.value, str) or isinstance(now, str):
        return "LOSS" if same_machine else "other machine"
    if math.isnan(now):
        return "LOSS"
    measure = Measure(figure.loss, figure.over)
    worse = measure.badness(now) - measure.badness(figure.value)
    if worse > figure.tolerance:
        return "LOSS"
    return "better" if worse < -figure.tolerance else "moved"
