"""Columns of edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from localiser.edges import Edges


def test_the_longest_edges_stay_in_their_order() -> None:
    edges = replace(Edges.from_bearings([0.1, 0.2, 0.3, 0.4], 0.01), length_px=np.array([50.0, np.nan, 200.0, 60.0]))
    np.testing.assert_array_equal(edges.longest(2).bearing, [0.3, 0.4])
    assert edges.longest(4) is edges and edges.longest(9) is edges
    unknown = Edges.from_bearings([0.1, 0.2, 0.3], 0.01)
    np.testing.assert_array_equal(unknown.longest(2).bearing, [0.1, 0.2])
