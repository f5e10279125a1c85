"""Poses in closed form: what the camera would see from a pose leads back to it."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from localiser import geometry
from localiser.geometry import wrap_angle
from localiser.relocalisation import from_three_bearings, from_two_bearings

property_test = settings(max_examples=80)
seeds = st.integers(0, 100_000)


def scene(seed, count):
    """A pose, landmarks (count, 2) ahead of it, and at what bearings and ranges they are seen."""
    rng = np.random.default_rng(seed)
    pose = rng.uniform([-20, -20, -np.pi], [20, 20, np.pi])
    in_robot = rng.uniform([-3, -8], [3, -0.5], (count, 2))
    right, back = in_robot.T
    return pose, geometry.map_from_robot(pose, in_robot), np.arctan2(right, -back), np.hypot(right, back)


def circle_gap(points, position):
    """How far, relative to its radius, a position is from the circle through three points."""
    (ax, az), (bx, bz), (cx, cz) = points
    rows = 2 * np.array([[bx - ax, bz - az], [cx - ax, cz - az]])
    centre = np.linalg.solve(rows, [bx**2 - ax**2 + bz**2 - az**2, cx**2 - ax**2 + cz**2 - az**2])
    radius = np.hypot(*(points[0] - centre))
    return abs(np.hypot(*(position - centre)) - radius) / radius


def assert_contains(poses, pose, atol=1e-6):
    error = poses - pose
    error[:, 2] = wrap_angle(error[:, 2])
    assert np.nanmin(np.abs(error).max(axis=1)) < atol


@property_test
@given(seed=seeds)
def test_three_bearings_give_the_pose(seed):
    pose, points, bearing, _ = scene(seed, 3)
    assume(np.abs(np.linalg.det(np.c_[points, np.ones(3)])) > 0.1)  # not in one line
    assume(circle_gap(points, pose[:2]) > 0.05)
    assert_contains(from_three_bearings(points[None], bearing[None]), pose)


def test_on_the_circle_through_the_landmarks_no_pose_is_made_up():
    angle = np.radians([20.0, 80.0, 130.0])
    points = 3.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    seen = geometry.robot_from_map(np.array([0.0, -3.0, np.pi]), points)
    bearing = np.arctan2(seen[:, 0], -seen[:, 1])
    assert np.isnan(from_three_bearings(points[None], bearing[None])).all()


def test_landmarks_behind_a_ray_give_no_pose():
    _, points, bearing, _ = scene(3, 3)
    bearing[0] = wrap_angle(bearing[0] + np.pi)
    assert np.isnan(from_three_bearings(points[None], bearing[None])).all()


@property_test
@given(seed=seeds, scale=st.floats(0.2, 5))
def test_two_bearings_and_the_ratio_of_ranges_give_the_pose(seed, scale):
    pose, points, bearing, range_m = scene(seed, 2)
    assume(np.hypot(*(points[0] - points[1])) > 0.05)
    found = from_two_bearings(points[:1], points[1:], bearing[None], scale * range_m[None])
    assert_contains(found, pose)


@property_test
@given(seed=seeds, ratio=st.floats(0.1, 10))
def test_whatever_the_ratio_both_bearings_are_held(seed, ratio):
    _, points, bearing, _ = scene(seed, 2)
    assume(np.abs(bearing[0] - bearing[1]) > 0.02)
    found = from_two_bearings(points[:1], points[1:], bearing[None], np.array([[ratio, 1.0]]))
    seen = geometry.robot_from_map(found, points)
    np.testing.assert_allclose(np.arctan2(seen[:, 0], -seen[:, 1]), bearing, atol=1e-8)
