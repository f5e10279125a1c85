"""Lines of many groups at once against numpy's fit of each."""

from __future__ import annotations

import numpy as np

from localiser.edges.groups import Groups


def test_lines_are_those_that_polyfit_finds_group_by_group():
    rng = np.random.default_rng(3)
    of = rng.permutation(np.repeat(np.arange(5), [2, 3, 10, 40, 7]))
    groups = Groups(of, 5)
    x, weight = rng.uniform(-50, 50, len(of)), rng.uniform(0.1, 4.0, len(of))
    y = 3.0 + 0.2 * x + rng.normal(0, 1, len(of))
    fit = groups.line(x, y, weight)
    for group in range(5):
        own = of == group
        slope, start = np.polyfit(x[own], y[own], 1, w=np.sqrt(weight[own]))
        np.testing.assert_allclose(fit.slope[group], slope, rtol=1e-8)
        np.testing.assert_allclose(fit.at(np.array([group]), np.zeros(1)), start, rtol=1e-8)
        np.testing.assert_allclose(fit.weight[group], weight[own].sum())
        about_mean = x[own] - np.average(x[own], weights=weight[own])
        np.testing.assert_allclose(fit.spread[group], (weight[own] * about_mean**2).sum())


def test_a_group_without_values_has_no_extremes():
    groups = Groups(np.array([0, 0, 2]), 3)
    values, mask = np.array([4.0, -1.0, 7.0]), np.array([True, True, False])
    np.testing.assert_array_equal(groups.lowest(values), [-1.0, np.inf, 7.0])
    np.testing.assert_array_equal(groups.highest(values, mask), [4.0, -np.inf, -np.inf])
