"""Sums, extremes and straight lines of values that belong to groups, for all groups at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from localiser.edges.columns_kernel import line_loop
from localiser.geometry import Array
from localiser.geometry.compiled import compiled

Values = Array | NDArray[np.int64]


class LineFit(NamedTuple):
    """Weighted straight lines y(x), one per group (G,): through (x, y) with `slope`.

    weight: Σw. spread: Σw (x - mean x)². With w = 1/σ² the variance of y is 1/weight, that of slope 1/spread.
    """

    x: Array
    y: Array
    slope: Array
    weight: Array
    spread: Array

    def at(self, group: NDArray[np.int64], x: Values) -> Array:
        """Return y (K,) of the lines of groups (K,) at x (K,)."""
        return np.asarray(self.y[group] + self.slope[group] * (x - self.x[group]))

    def take(self, index: NDArray[np.int64]) -> LineFit:
        """Return the lines of some groups."""
        return LineFit._make(column[index] for column in self)


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Which group, 0 … count - 1, each of K values belongs to."""

    of: NDArray[np.int64]
    count: int

    def sum(self, values: Array | NDArray[np.bool_]) -> Array:
        """Return the sum (G,) of values (K,) of each group."""
        return np.asarray(np.bincount(self.of, values, self.count), dtype=np.float64)

    def lowest(self, values: Values, mask: NDArray[np.bool_] | None = None) -> Array:
        """Return the lowest (G,) of the values (K,) of each group, of the masked ones only; inf for none."""
        lowest = np.full(self.count, np.inf)
        used = slice(None) if mask is None else mask
        np.minimum.at(lowest, self.of[used], values[used].astype(np.float64))  # many times slower for integers
        return lowest

    def highest(self, values: Values, mask: NDArray[np.bool_] | None = None) -> Array:
        """Return the highest (G,) of the values (K,) of each group, of the masked ones only; -inf for none."""
        return -self.lowest(-values, mask)

    def line(self, x: Values, y: Array, weight: Array) -> LineFit:
        """Return the weighted least-squares line of each group through (x, y) (K,)."""
        return LineFit(*compiled(line_loop)(self.of, self.count, x.astype(np.float64), y, weight))
