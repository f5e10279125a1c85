"""Figures as they are now beside those of the baseline."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

from figures.measures import Loss, Measure

Verdict = Literal["same", "moved", "better", "new", "skipped", "other machine", "gone", "LOSS"]
ORDER: tuple[Verdict, ...] = get_args(Verdict)
LOSSES: tuple[Verdict, ...] = ("gone", "LOSS")
"""A figure that is no longer measured, although it could be, is lost too."""
Value = float | str
Key = tuple[str, str, str]
"""Group, case and measure of a figure."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of the baseline.

    tolerance: how much worse it may be, in its own unit, or in its logarithm where it should be one. over: what sums up
    its seeds. samples: its values with all seeds that it was measured with.
    """

    value: Value
    loss: Loss
    tolerance: float = 0.0
    over: Literal["median", "mean"] = "median"
    samples: Sequence[float] = ()


@dataclass(frozen=True, slots=True)
class Compared:
    """A figure before and now, None where there is none. reason: why it could not be compared."""

    key: Key
    verdict: Verdict
    before: Figure | None = None
    now: Value | None = None
    reason: str = ""


def compared(
    baseline: Mapping[Key, Figure], now: Mapping[Key, Value], unmeasured: Mapping[Key, str], failed: Mapping[Key, str]
) -> list[Compared]:
    """Return the verdict on every figure that is in the baseline, or was measured, or both.

    unmeasured: why figures of the baseline cannot be measured here. failed: what went wrong in measuring others.
    """
    result = []
    for key, figure in baseline.items():
        if key in failed:
            result.append(Compared(key, "LOSS", figure, reason=failed[key]))
        elif key in unmeasured:
            result.append(Compared(key, "skipped", figure, reason=unmeasured[key]))
        elif key not in now:
            result.append(Compared(key, "gone", figure, reason="no longer measured"))
        else:
            result.append(Compared(key, verdict_of(figure, now[key]), figure, now[key]))
    return result + [Compared(key, "new", None, value) for key, value in now.items() if key not in baseline]


def elsewhere(one: Compared) -> Compared:
    """Return the verdict on a figure that depends on the machine, where that is another one than the baseline's."""
    if one.verdict != "LOSS" or one.now is None:
        return one
    return replace(one, verdict="other machine", reason="another processor, or other libraries")


def verdict_of(figure: Figure, now: Value) -> Verdict:
    """Return whether a figure is as it was, within what chance may do, or past it."""
    if figure.value == now:
        return "same"
    if isinstance(figure.value, str) or isinstance(now, str) or math.isnan(now):
        return "LOSS"
    measure = Measure(figure.loss, figure.over)
    worse = measure.badness(now) - measure.badness(figure.value)
    if worse > figure.tolerance:
        return "LOSS"
    return "better" if worse < -figure.tolerance else "moved"
