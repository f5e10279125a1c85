"""Landmarks by cell of floor and heading, against plain counting."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from localiser.landmarks import CELL_M, HEADINGS, LandmarkIndex, in_camera


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), half_view=st.floats(0.1, 1.5))
def test_a_cell_lists_every_landmark_that_can_be_in_view(seed, half_view):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-4, 4, (30, 2))
    index = LandmarkIndex.of(points, np.full(2, -4.0), np.full(2, 4.0), half_view, 5.0)
    poses = rng.uniform([-4, -4, -np.pi], [4, 4, np.pi], (50, 3))
    right, ahead = in_camera(poses, points)
    seen = (np.abs(np.arctan2(right, ahead)) <= half_view) & (np.hypot(right, ahead) <= 5.0)
    for pose, visible in zip(poses, seen, strict=True):
        column, row = ((pose[:2] - index.corner) / CELL_M).astype(int)
        turn = int((pose[2] + np.pi) * HEADINGS / (2 * np.pi)) % HEADINGS
        cell = (column * index.shape[1] + row) * HEADINGS + turn
        listed = index.item[index.start[cell] : index.start[cell + 1]]
        assert set(np.flatnonzero(visible)) <= set(listed)


def test_a_narrow_view_leaves_most_landmarks_out() -> None:
    points = np.random.default_rng(0).uniform(-4, 4, (30, 2))
    index = LandmarkIndex.of(points, np.full(2, -4.0), np.full(2, 4.0), np.radians(30), 12.0)
    assert np.diff(index.start).mean() < 0.6 * len(points)
