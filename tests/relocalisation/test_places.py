"""Pairs of landmarks by distance, against a table of all pairs; and finding a robot in a large building."""

from __future__ import annotations

import numpy as np
import pytest
import scale_building
from board.run import run
from proposal_room import CAMERA, drawn_frames, room
from scipy.stats import poisson

from localiser.geometry import wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.relocalisation import Places, hypotheses, places, view_of


def on_a_grid() -> LandmarkMap:
    """Landmarks of which very many pairs are equally far apart."""
    points = np.stack(np.meshgrid(np.arange(20.0), np.arange(12.0)), axis=-1).reshape(-1, 2)
    return LandmarkMap.from_points(points, bottom_m=np.where(np.arange(240) % 3 == 0, 0.5, 0.0))


def table_of(landmark_map: LandmarkMap, farthest_m: float):
    """Pairs, classes and distances by a table of all pairs."""
    points = landmark_map.points
    _, group = np.unique(np.round(landmark_map.bottom_m / places.BOTTOM_STEP_M), return_inverse=True)
    distance = np.hypot(*(points[:, None] - points[None, :]).T).T
    first, second = np.nonzero((distance > 1e-3) & (distance <= farthest_m))
    pair_class = group[first] * (group.max() + 1) + group[second]
    order = np.lexsort((distance[first, second], pair_class))
    return np.stack([first, second], axis=-1)[order], pair_class[order], distance[first, second][order]


@pytest.mark.parametrize("landmark_map", [room(200), on_a_grid()], ids=["room", "grid"])
@pytest.mark.parametrize("as_integers", [False, True])
def test_pairs_are_those_of_a_table_of_all(landmark_map, as_integers, monkeypatch):
    if as_integers:
        monkeypatch.setattr(places, "FEWEST_AS_INTEGERS", 1)
    found = Places.of(landmark_map, CAMERA)
    pair, pair_class, distance = table_of(landmark_map, 2 * found.sight.range_max_m)
    np.testing.assert_array_equal(found.pair, pair)
    np.testing.assert_allclose(found.key, pair_class * (2 * found.sight.range_max_m + 1.0) + distance, atol=1e-8)
    assert (np.diff(found.key) >= 0).all()


def test_of_too_many_pairs_the_farthest_are_left_out(monkeypatch):
    landmark_map = room(200)
    every = Places.of(landmark_map, CAMERA)
    monkeypatch.setattr(places, "MOST_PAIRS", len(every.pair) // 2)
    nearest = Places.of(landmark_map, CAMERA)
    step = 2 * every.sight.range_max_m + 1.0
    assert len(every.pair) // 3 < len(nearest.pair) <= len(every.pair) // 2
    limit = (nearest.key % step).max()
    assert len(nearest.pair) == ((every.key % step) <= limit).sum()


def test_an_image_tries_no_more_poses_than_asked_for_on_a_large_map(monkeypatch):
    """And in many images one of them is near the true one, though a pair of edges could be any of thousands."""
    floor = scale_building.floor_of(3000)
    drive = scale_building.drive_of(floor, 40, 30)
    many = Places.of(floor.landmark_map, drive.camera)
    assert many.are_many
    looked_up = []
    from_bearings = hypotheses.from_two_bearings
    monkeypatch.setattr(
        hypotheses, "from_two_bearings", lambda *some: looked_up.append(len(some[0])) or from_bearings(*some)
    )
    near = []
    for pose, edges in zip(drive.truth, drive.edges, strict=True):
        poses, _ = hypotheses.from_feet(view_of(drive.camera, edges), many, 5000, np.random.default_rng(0))
        near.append((np.hypot(*(poses[:, :2] - pose[:2]).T) < 0.3).any())
    assert 0 < max(looked_up) <= 5000
    assert np.mean(near) > 0.3


@pytest.mark.parametrize("landmarks", [1000, 3000, pytest.param(10_000, marks=pytest.mark.slow)])
def test_how_often_a_pose_that_is_tried_is_the_true_one_is_predicted(landmarks):
    """In 100 images, half to four times as often as expected, with the 99.7 % range of what is expected then."""
    floor = scale_building.floor_of(landmarks)
    drive = scale_building.drive_of(floor, 40, 100)
    many, rng = Places.of(floor.landmark_map, drive.camera), np.random.default_rng(0)
    found, expected = 0, []
    for pose, edges in zip(drive.truth, drive.edges, strict=True):
        poses, hits = hypotheses.from_feet(view_of(drive.camera, edges), many, 12_500, rng)
        near = np.hypot(*(poses[:, :2] - pose[:2]).T) < 0.3
        near &= np.abs(wrap_angle(poses[:, 2] - pose[2])) < np.radians(6.0)
        found += near.any()
        expected.append(hits)
    least, most = (1.0 - np.exp(-factor * np.array(expected)) for factor in (0.5, 4.0))
    assert found > least.sum() - 3 * np.sqrt((least * (1.0 - least)).sum()) > 0
    assert found < most.sum() + 3 * np.sqrt((most * (1.0 - most)).sum())


def test_how_often_three_edges_are_the_right_landmarks_is_predicted():
    """On a small map whose landmarks have no feet, as many triples as expected within a factor of three."""
    landmark_map = room(15)
    poses, frames = drawn_frames(landmark_map, 40, seed=1, clutter=3)
    small, rng = Places.of(landmark_map, CAMERA), np.random.default_rng(0)
    found, expected = 0, 0.0
    for pose, edges in zip(poses, frames, strict=True):
        tried, hits = hypotheses.from_bearings(view_of(CAMERA, edges), small, 12_500, rng)
        near = np.hypot(*(tried[:, :2] - pose[:2]).T) < 0.1
        near &= np.abs(wrap_angle(tried[:, 2] - pose[2])) < np.radians(2.0)
        found, expected = found + int(near.sum()), expected + hits
    assert expected / 3 < found < 3 * expected and found > 10


def test_the_more_of_the_poses_are_tried_the_surer_one_of_them_is_the_true_one():
    floor = scale_building.floor_of(3000)
    drive = scale_building.drive_of(floor, 40, 1)
    view, many = view_of(drive.camera, drive.edges[0]), Places.of(floor.landmark_map, drive.camera)
    hits = [hypotheses.from_feet(view, many, count, np.random.default_rng(0))[1] for count in (1000, 2000, 8000)]
    assert hits == pytest.approx([hits[0], 2 * hits[0], 8 * hits[0]], rel=1e-3)


@pytest.mark.slow
def test_no_place_of_a_large_building_is_sure_before_others_were_looked_at():
    """A pair of edges may be any of thousands, and each image tries a few of them.

    Of twelve drives, most are found. Those that are sure of a wrong place are no more than p_correct says (99 %).
    """
    floor, rng, records = scale_building.floor_of(10_000), np.random.default_rng(5), []
    for seed in range(12):
        drive = scale_building.drive_of(floor, int(rng.integers(floor.rooms - 12)), 40, seed)
        records.append(run(drive, seed, start=None))
    sure = [record for record in records if record.sure.any()]
    first = [int(np.argmax(record.sure)) for record in sure]
    assert min(first) > 10 and len(sure) > 6
    wrong = [not record.right[index] for record, index in zip(sure, first, strict=True)]
    said = [1.0 - record.p_correct[index] for record, index in zip(sure, first, strict=True)]
    assert sum(wrong) <= poisson.ppf(0.99, sum(said))
    assert sum(bool(record.right[-1]) for record in records) > 6


def test_a_robot_is_found_in_a_building_of_a_thousand_landmarks():
    drive = scale_building.drive_of(scale_building.floor_of(1000), 50, 30, seed=1)
    record = run(drive, 1, start=None)
    assert record.sure.any()
    assert record.right[record.sure].all()


def test_the_first_rooms_of_a_larger_building_are_those_of_a_smaller_one():
    small, large = scale_building.floor_of(100), scale_building.floor_of(1000)
    assert len(large.landmark_map) == 1000
    apart = np.abs(small.landmark_map.points - large.landmark_map.points[:100])
    assert apart.max() < 0.1  # but for the errors of the map
    again = scale_building.floor_of(100)
    np.testing.assert_array_equal(small.landmark_map.points, again.landmark_map.points)


def test_few_hypotheses_on_a_small_map_are_the_first_of_many():
    landmark_map = room()
    _, frames = drawn_frames(landmark_map, 40, seed=1, clutter=10)
    edges = max(frames, key=len)
    small = Places.of(landmark_map, CAMERA)
    few, many = (
        hypotheses.from_feet(view_of(CAMERA, edges), small, n, np.random.default_rng(3))[0] for n in (50, 20_000)
    )
    np.testing.assert_array_equal(few, many[:50])
