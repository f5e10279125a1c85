"""Furnished rooms for judging feet."""

from __future__ import annotations

import numpy as np
import pytest
from edge_feet import Feet, fitted
from edge_rooms import room_views


@pytest.mark.slow
def test_a_room_is_the_same_for_the_same_seed_and_another_for_another() -> None:
    first, again, other = (next(room_views(seed, 1)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.image, again.image)
    assert first.image.shape == (480, 640)
    assert first.scene.camera.mount != other.scene.camera.mount
    bottom = first.scene.structure.solids.bottom_m
    assert (bottom == 0).any()
    assert (bottom > 0.3).any()


def test_the_fit_finds_the_log_odds_that_ends_were_drawn_with() -> None:
    rng = np.random.default_rng(0)
    truth = np.array([0.5, -1.0, 2.0, 0.0, -0.5, 1.0])
    evidence = np.column_stack([np.ones(40_000), rng.normal(0, 1, (40_000, 5))])
    stands = rng.random(40_000) < 1 / (1 + np.exp(-evidence @ truth))
    feet = Feet(np.zeros(40_000), np.where(stands, 0.0, 100.0), evidence)
    np.testing.assert_allclose(list(fitted([(1.0, [feet])]).values()), truth, atol=0.11)
