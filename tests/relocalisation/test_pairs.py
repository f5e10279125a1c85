"""Pairs of landmarks by distance, against a table of all pairs; and finding a robot in a large building."""

import numpy as np
import pytest
import scale_building
from board.run import run
from hypothesis import given, settings
from hypothesis import strategies as st
from proposal_room import CAMERA, drawn_frames, room
from scipy.stats import poisson

from localiser.geometry import wrap_angle
from localiser.landmarks import LandmarkMap, SightParameters
from localiser.observation import Frame, ObservationParameters
from localiser.relocalisation import hypotheses
from localiser.relocalisation.global_localisation import Region
from localiser.relocalisation.hypotheses import Feet, LandmarkPairs


def on_a_grid() -> LandmarkMap:
    """Landmarks of which very many pairs are equally far apart."""
    points = np.stack(np.meshgrid(np.arange(20.0), np.arange(12.0)), axis=-1).reshape(-1, 2)
    return LandmarkMap.from_points(points, bottom_m=np.where(np.arange(240) % 3 == 0, 0.5, 0.0))


def table_of(landmark_map: LandmarkMap, farthest_m: float):
    """Pairs, classes and distances by a table of all pairs."""
    points = landmark_map.points
    _, group = np.unique(np.round(landmark_map.bottom_m / hypotheses.BOTTOM_STEP_M), return_inverse=True)
    distance = np.hypot(*(points[:, None] - points[None, :]).T).T
    first, second = np.nonzero((distance > 1e-3) & (distance <= farthest_m))
    pair_class = group[first] * (group.max() + 1) + group[second]
    order = np.lexsort((distance[first, second], pair_class))
    return np.stack([first, second], axis=-1)[order], pair_class[order], distance[first, second][order]


def seen_by(camera, edges):
    return Feet.of(Frame(edges, camera))


def pairs_of(landmark_map):
    return LandmarkPairs.of(landmark_map, ObservationParameters())


@pytest.mark.parametrize("landmark_map", [room(200), on_a_grid()], ids=["room", "grid"])
def test_pairs_are_those_of_a_table_of_all(landmark_map):
    found, farthest_m = pairs_of(landmark_map), 2 * SightParameters().range_max_m
    pair, pair_class, distance = table_of(landmark_map, farthest_m)
    key = pair_class * (farthest_m + 1.0) + distance
    np.testing.assert_allclose(found.key, key, atol=1e-9)
    assert (np.diff(found.key) >= 0).all()
    # Those of the same distance may come in any order.
    one, other = (
        set(map(tuple, np.column_stack([pairs, np.round(keys, 6)]).tolist()))
        for pairs, keys in ((found.pair, found.key), (pair, key))
    )
    assert one == other


@settings(max_examples=40)
@given(low=st.floats(-1, 9), width=st.floats(0, 2), first=st.integers(0, 39), second=st.integers(0, 39))
def test_pairs_are_found_by_class_and_distance(low, width, first, second):
    landmark_map = room()
    found, points = pairs_of(landmark_map), landmark_map.points
    group = np.searchsorted(found.class_m, landmark_map.bottom_m - 0.0251)
    begin, end = found.between(
        np.array([group[first] * len(found.class_m) + group[second]]), np.array([low]), np.array([low + width])
    )
    within = {tuple(pair) for pair in found.pair[begin[0] : end[0]].tolist()}
    apart = np.hypot(*(points[:, None] - points).T).T
    alike = (group[:, None] == group[first]) & (group == group[second]) & ~np.eye(len(points), dtype=bool)
    assert within == set(
        zip(*(index.tolist() for index in np.nonzero(alike & (apart >= low) & (apart <= low + width))), strict=True)
    )


def test_of_too_many_pairs_about_the_nearest_are_kept(monkeypatch):
    landmark_map = room(200)
    every = pairs_of(landmark_map)
    monkeypatch.setattr(hypotheses, "MOST_PAIRS", len(every.pair) // 2)
    nearest = pairs_of(landmark_map)
    assert len(every.pair) // 3 < len(nearest.pair) < 0.7 * len(every.pair)
    limit = (nearest.key % nearest.step).max()
    assert len(nearest.pair) == ((every.key % every.step) <= limit).sum()


def test_a_region_has_its_draws_inside_and_its_density_sums_to_one():
    region = Region(np.array([-2.0, -1.0, -np.pi]), np.array([3.0, 1.5, np.pi]))
    poses = region.drawn(2000, np.random.default_rng(3))
    assert region.contains(poses).all() and not region.contains(poses + np.array([5.0, 0.0, 0.0])).any()
    np.testing.assert_allclose(poses.mean(axis=0), [0.5, 0.25, 0.0], atol=0.15)
    assert np.exp(region.log_density) * 5.0 * 2.5 * 2 * np.pi == pytest.approx(1.0)


def test_an_image_tries_no_more_poses_than_asked_for_on_a_large_map(monkeypatch):
    """And in many images one of them is near the true one, though a pair of edges could be any of thousands."""
    floor = scale_building.floor_of(3000)
    drive = scale_building.drive_of(floor, 40, 30)
    many = pairs_of(floor.landmark_map)
    assert len(many.pair) > hypotheses.MANY_PAIRS
    looked_up = []
    from_bearings = hypotheses.from_two_bearings
    monkeypatch.setattr(
        hypotheses, "from_two_bearings", lambda *some: looked_up.append(len(some[0])) or from_bearings(*some)
    )
    near = []
    for pose, edges in zip(drive.truth, drive.edges, strict=True):
        poses, _ = hypotheses.from_feet(seen_by(drive.camera, edges), many, 5000, np.random.default_rng(0))
        near.append((np.hypot(*(poses[:, :2] - pose[:2]).T) < 0.3).any())
    assert 0 < max(looked_up) <= 5000
    assert np.mean(near) > 0.3


@pytest.mark.parametrize("landmarks", [1000, 3000, pytest.param(10_000, marks=pytest.mark.slow)])
def test_how_often_a_pose_that_is_tried_is_the_true_one_is_predicted(landmarks):
    """In 100 images, half to four times as often as expected, with the 99.7 % range of what is expected then."""
    floor = scale_building.floor_of(landmarks)
    drive = scale_building.drive_of(floor, 40, 100)
    many, rng = pairs_of(floor.landmark_map), np.random.default_rng(0)
    found, expected = 0, []
    for pose, edges in zip(drive.truth, drive.edges, strict=True):
        poses, hits = hypotheses.from_feet(seen_by(drive.camera, edges), many, 12_500, rng)
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
    small, rng = pairs_of(landmark_map), np.random.default_rng(0)
    found, expected = 0, 0.0
    for pose, edges in zip(poses, frames, strict=True):
        tried, hits = hypotheses.from_bearings(seen_by(CAMERA, edges), small, 12_500, rng)
        near = np.hypot(*(tried[:, :2] - pose[:2]).T) < 0.1
        near &= np.abs(wrap_angle(tried[:, 2] - pose[2])) < np.radians(2.0)
        found, expected = found + int(near.sum()), expected + hits
    assert expected / 3 < found < 3 * expected and found > 10


def test_the_more_of_the_poses_are_tried_the_surer_one_of_them_is_the_true_one():
    floor = scale_building.floor_of(3000)
    drive = scale_building.drive_of(floor, 40, 1)
    view, many = seen_by(drive.camera, drive.edges[0]), pairs_of(floor.landmark_map)
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
