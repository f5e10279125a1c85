"""The best one-to-one assignment of edges to landmarks."""

from __future__ import annotations

import numpy as np

from localiser.mapping.tracks import assign

NEVER = -np.inf


def test_a_match_that_another_rivals_is_left_out_where_a_margin_is_asked_for() -> None:
    score = np.array([[9.0, 8.0, NEVER], [NEVER, NEVER, 4.0], [NEVER, NEVER, NEVER]])
    assert [pair.tolist() for pair in assign(score)] == [[0, 1], [0, 2]]
    assert [pair.tolist() for pair in assign(score, margin=3.0)] == [[1], [2]]


def test_a_rival_for_the_edge_counts_as_one_for_the_landmark() -> None:
    score = np.array([[9.0], [7.0]])
    assert assign(score)[0].tolist() == [0]
    assert assign(score, margin=3.0)[0].tolist() == []
    assert assign(score, margin=1.0)[0].tolist() == [0]
