"""What a figure means: which way is a loss, how seeds are summed up, and how far chance alone may move it.

Tolerance. A figure is the median (of errors) or the mean (of shares and ratios) over k seeds. Its values v₁ … vₙ with
n = 20 seeds say how much chance moves one of them. The standard error s of the figure over k seeds is the standard
deviation of that median or mean over draws of k of the n, with replacement [Efron 1979], times √(n/(n − 1)), because
the n spread less about their own mean than about the true one. Code that is as good but draws other random numbers
gives a figure that differs from the baseline's by N(0, 2s²), since both are of k seeds. It is a loss when it is worse
by more than z·√2·s with z = 3.09, which chance exceeds once in a thousand figures.

Where all n values are equal the tolerance is 0: what was never sure and wrong may not become so once. That is strict,
since 20 seeds without a failure still allow a true rate of 14 % [rule of three]; such a loss is a seed to look at.
Figures without seeds have no spread, and whatever makes them worse is a loss. The file says how many seeds a group was
measured with; with fewer than 20 the same rule holds, and the tolerance is less certain.

NEES over its degrees of freedom should be 1. It is compared by the size of its logarithm: twice and half are as bad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

Z = 3.09  # of a normal variable: exceeded once in a thousand
DRAWS = 4000
Loss = Literal["up", "down", "from one", "change"]
"""Which way a figure gets worse."""


@dataclass(frozen=True, slots=True)
class Measure:
    """How a figure is read. over: what sums up its seeds. least: tolerance, as a share, for what no seed changes."""

    loss: Loss
    over: Literal["median", "mean"] = "median"
    least: float = 0.0

    def of(self, samples: Sequence[float]) -> float:
        """Return the figure over these seeds."""
        return float(np.median(samples) if self.over == "median" else np.mean(samples))

    def scaled(self, value: float | np.ndarray) -> np.ndarray:
        """Return the figure as it is compared: ratios that should be 1 by their logarithm."""
        return np.log(np.maximum(value, 1e-12)) if self.loss == "from one" else np.asarray(value, dtype=float)

    def badness(self, value: float) -> float:
        """Return what grows as the figure gets worse."""
        scaled = float(self.scaled(value))
        return {"up": scaled, "down": -scaled, "from one": abs(scaled)}[self.loss]


def tolerance(measure: Measure, samples: Sequence[float], count: int) -> float:
    """Return how much worse a figure over `count` seeds may be by chance; samples: its values with many seeds."""
    values = np.array(samples, dtype=float)
    if np.ptp(values) == 0:
        return 0.0
    drawn = values[np.random.default_rng(0).integers(len(values), size=(DRAWS, count))]
    figures = np.median(drawn, axis=1) if measure.over == "median" else drawn.mean(axis=1)
    deviation = measure.scaled(figures).std() * np.sqrt(len(values) / (len(values) - 1))
    return float(Z * np.sqrt(2) * deviation)
