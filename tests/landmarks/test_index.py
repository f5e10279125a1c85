"""Which landmarks are within reach of a place, and in view from a cell and heading."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from localiser.camera import Camera, Mount
from localiser.landmarks import (
    LandmarkMap,
    Reach,
    SightParameters,
    in_camera,
    in_view_of_cells,
    reach_of,
    sight,
    visibility,
)
from localiser.landmarks.index import MOST_PIECES, PIECE_M


def listed(points, half_view, range_m):
    """Return start and item of the lists of cells of 0.5 m and 32 headings, between -4 and 4 m."""
    per_unit, shape = np.array([2.0, 2.0, 32 / (2 * np.pi)]), np.array([16, 16, 32])
    low, every = np.array([-4.0, -4.0, -np.pi]), np.arange(shape.prod() + 1)
    reach = Reach.of(points, range_m + 0.5)
    return in_view_of_cells(every, low, per_unit, shape, points, half_view, range_m, reach)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), half_view=st.floats(0.1, 1.5))
def test_a_cell_lists_every_landmark_that_can_be_in_view(seed, half_view):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-4, 4, (30, 2))
    start, item = listed(points, half_view, 5.0)
    poses = rng.uniform([-4, -4, -np.pi], [4, 4, np.pi], (50, 3))
    right, ahead = in_camera(poses, points)
    seen = (np.abs(np.arctan2(right, ahead)) <= half_view) & (np.hypot(right, ahead) <= 5.0)
    for pose, visible in zip(poses, seen, strict=True):
        column, row = ((pose[:2] + 4.0) * 2.0).astype(int)
        cell = (column * 16 + row) * 32 + int((pose[2] + np.pi) * 32 / (2 * np.pi)) % 32
        assert set(np.flatnonzero(visible)) <= set(item[start[cell] : start[cell + 1]])


def test_a_narrow_view_leaves_most_landmarks_out() -> None:
    points = np.random.default_rng(0).uniform(-4, 4, (30, 2))
    start, _ = listed(points, np.radians(30), 12.0)
    assert np.diff(start).mean() < 0.6 * len(points)


CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20.0), 0.9, back_m=-0.1))


def scattered(count: int, side_m: float, seed: int = 0) -> LandmarkMap:
    return LandmarkMap.from_points(np.random.default_rng(seed).uniform(0, side_m, (count, 2)))


def test_every_landmark_in_range_of_a_point_is_listed_and_far_ones_are_not():
    points = scattered(800, 120.0).points
    reach = Reach.of(points, 10.0)
    for point in np.random.default_rng(1).uniform(-20, 140, (200, 2)):
        listed = reach.beside(point[None])
        distance = np.hypot(*(points - point).T)
        assert set(np.flatnonzero(distance <= 10.0)) <= set(listed)
        assert (np.diff(listed) > 0).all()
        assert (distance[listed] <= 10.0 + 1.5 * PIECE_M).all()


def test_pieces_grow_where_landmarks_are_a_world_apart():
    points = np.array([[0.0, 0.0], [9e5, -9e5]])
    reach = Reach.of(points, 16.0)
    assert len(reach.start) <= MOST_PIECES + 2
    assert reach.beside(points[1:]).tolist() == [1]


def test_it_is_made_once_for_a_map_and_goes_with_it():
    landmark_map = scattered(50, 20.0)
    assert reach_of(landmark_map, 12.0) is reach_of(landmark_map, 12.0)
    lives = weakref.ref(landmark_map)
    del landmark_map
    gc.collect()
    assert lives() is None


@pytest.mark.parametrize("poses", [1, 40])
def test_sight_on_a_large_map_is_that_of_all_its_landmarks(poses, monkeypatch):
    landmark_map = scattered(3000, 80.0)
    rng = np.random.default_rng(2)
    cameras = np.column_stack([rng.uniform(20, 60, (poses, 2)), rng.uniform(-np.pi, np.pi, poses)])
    found = sight(CAMERA, cameras, landmark_map, SightParameters())
    monkeypatch.setattr(visibility, "FEW", len(landmark_map))
    expected = sight(CAMERA, cameras, landmark_map, SightParameters())
    assert len(found.pose) > 10 * poses
    for column in ("pose", "landmark", "tangent", "length_px"):
        np.testing.assert_array_equal(getattr(found, column), getattr(expected, column))
