"""Finished maps: aligned with unknown correspondence, put together, and the quality of their landmarks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from map_commands import run

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import map_from_robot, robot_from_map, wrap_angle
from localiser.landmarks import LandmarkMap, Quality
from localiser.mapping import agreeing, align, duplicates, fuse_maps, join_maps, matches, merge_duplicates
from localiser.mapping.landmarks import fit_landmarks
from localiser.mapping.quality import is_placed
from localiser.mapping.sightings import Sightings, direction_of
from localiser.storage import read_map, write_map


def hall(seed: int, count: int = 40) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-6, -9], [6, 1], (count, 2))


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 1000))
def test_maps_are_aligned_though_much_differs(seed: int) -> None:
    """A third is missing from the second map, a fifth of it is new, places are 3 cm off."""
    rng = np.random.default_rng(seed)
    first = hall(seed)
    pose = np.array([*rng.uniform(-20, 20, 2), rng.uniform(-np.pi, np.pi)])
    kept = rng.permutation(40)[:27]
    second = robot_from_map(
        pose, np.concatenate([first[kept] + rng.normal(0, 0.03, (27, 2)), rng.uniform(-6, 1, (7, 2))])
    )
    found = align(first, second, 0.15)
    assert np.hypot(*(found.pose - pose)[:2]) < 0.2
    assert abs(wrap_angle(found.pose[2] - pose[2])) < np.deg2rad(0.7)
    right = [kept[j] == i for i, j in found.pairs if j < 27]
    assert sum(right) >= 24
    assert found.alternative < 0.7
    assert map_from_robot(found.pose, second[:27]) == pytest.approx(first[kept], abs=0.2)


def test_a_building_that_looks_like_itself_is_told() -> None:
    """Two rows of posts, turned by half a turn, are the same posts."""
    posts = np.array([[x, z] for x in (-2.0, 2.0) for z in np.arange(0.0, 12.0, 1.5)])
    assert align(posts, posts, 0.1).alternative == pytest.approx(1.0)


def test_maps_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 3"):
        align(np.array([[0.0, 0.0], [1.0, 0.0], [5.0, 5.0]]), np.array([[0.0, 0.0], [9.0, 0.0], [20.0, 3.0]]), 0.05)


def known(points: list[list[float]], sigma: float, ids: tuple[int | str, ...], **columns: object) -> LandmarkMap:
    plain = LandmarkMap.from_points(np.array(points), ids=ids, source="a log")
    return replace(plain, cov=np.tile(sigma**2 * np.eye(2), (len(points), 1, 1)), **columns)


def test_fusing_weighs_by_covariance_and_keeps_what_is_alone() -> None:
    plan = known([[0.0, 0.0], [5.0, 0.0]], 0.03, (0, 1), bottom_m=np.zeros(2))
    quality = Quality(np.array([9.0, 8.0]), np.array([0.5, 0.4]), np.array([0.9, 0.8]))
    built = known([[0.04, 0.0], [9.0, 1.0]], 0.01, (0, "b"), polarity=np.array([1, -1], dtype=np.int8), quality=quality)
    pairs = matches(plan.points, built.points, 0.15)
    assert pairs.tolist() == [[0, 0]]
    whole = fuse_maps(plan, built, pairs)
    assert whole.ids == (0, 1, "b")
    assert whole.points == pytest.approx(np.array([[0.036, 0.0], [5.0, 0.0], [9.0, 1.0]]))
    assert whole.cov[0, 0, 0] == pytest.approx(1 / (1 / 0.03**2 + 1 / 0.01**2))
    assert whole.polarity.tolist() == [1, 0, -1]
    assert whole.bottom_m[0] == 0.0
    assert whole.source[0] == "a log; a log"
    assert whole.quality.sightings == pytest.approx([9.0, np.nan, 8.0], nan_ok=True)


def test_an_unknown_covariance_lets_the_other_place_count() -> None:
    surveyed = LandmarkMap.from_points(np.array([[0.0, 0.0]]))
    built = known([[0.1, 0.0]], 0.01, (7,))
    pairs = np.array([[0, 0]])
    assert fuse_maps(surveyed, built, pairs).points[0, 0] == pytest.approx(0.1)
    assert fuse_maps(built, surveyed, pairs).points[0, 0] == pytest.approx(0.1)


def test_maps_are_read_again_though_their_ends_cross_and_their_places_are_known_exactly(tmp_path: Path) -> None:
    cov = np.array([np.zeros((2, 2)), np.full((2, 2), 1e-4), [[1e-4, np.nextafter(1e-4, 1)], [0.0, 1e-4]]])
    plan = LandmarkMap.from_points(np.array([[0.0, 0.0], [5.0, 0.0], [9.0, 0.0]]), bottom_m=np.array([1.5, 0.5, 0.0]))
    plan = replace(plan, cov=cov)
    built = replace(plan, bottom_m=np.full(3, np.nan), top_m=np.full(3, 1.0))
    write_map(fuse_maps(plan, built, np.array([[0, 0], [1, 1]])), tmp_path / "map.yaml")
    whole = read_map(tmp_path / "map.yaml")
    np.testing.assert_array_equal([whole.bottom_m[:2], whole.top_m[:2]], [[np.nan, 0.5], [np.nan, 1.0]])
    assert whole.cov[:2] == pytest.approx(cov[:2] / 2) and whole.points[:3] == pytest.approx(plan.points)


def test_contradictions_are_not_fused() -> None:
    light = known([[0.0, 0.0], [1.0, 0.0]], 0.01, (0, 1), polarity=np.array([1, 1], dtype=np.int8))
    dark = known([[0.0, 0.0], [1.09, 0.0]], 0.01, (0, 1), polarity=np.array([-1, 1], dtype=np.int8))
    assert agreeing(light, dark, np.array([[0, 0], [1, 1]]), 0.01).tolist() == [False, False]
    assert agreeing(light, dark, np.array([[0, 0], [1, 1]]), 0.12).tolist() == [False, True]


def test_ids_stay_unique() -> None:
    joined = join_maps(known([[0.0, 0.0]] * 3, 0.1, (0, "7", 9)), known([[1.0, 1.0]] * 3, 0.1, (7, 8, 9)))
    assert joined.ids == (0, "7", 9, 10, 8, 11)
    assert len({str(name) for name in joined.ids}) == 6
    assert map_from_robot(np.zeros(3), joined.points).shape == (6, 2)


def test_maps_of_any_width_are_aligned_within_memory() -> None:
    """Two landmarks a thousand kilometres apart: the places between them are not counted one by one."""
    first = np.concatenate([hall(1), [[-1e6, -1e6], [1e6, 1e6]]])
    assert len(align(first, first, 0.15).pairs) == len(first)


def five() -> LandmarkMap:
    """Return three landmarks at one place, one 0.5 m away, and one as near as that with the other polarity."""
    points = np.array([[1.0, 2.0], [1.01, 2.0], [1.005, 2.01], [1.5, 2.0], [1.5, 2.01]])
    plain = LandmarkMap.from_points(points, bottom_m=np.array([0.0, 0.5, 0.0, 0.0, 0.0]), top_m=np.full(5, 2.0))
    sightings = np.array([5.0, 20.0, 10.0, 5.0, 5.0])
    quality = Quality(sightings, np.full(5, 0.3), np.full(5, 0.99))
    cov = np.tile(1e-4 * np.eye(2), (5, 1, 1))
    return replace(plain, cov=cov, quality=quality, polarity=np.array([1, 1, 0, 1, -1], dtype=np.int8))


def test_three_at_one_place_become_the_one_that_most_images_show() -> None:
    merged, gone = merge_duplicates(five())
    assert merged.ids == (1, 3, 4) and sorted(other for _, other in gone) == [0, 2]
    assert merged.points[0] == pytest.approx([1.005, 2.0033], abs=1e-4)
    assert merged.cov[0] == pytest.approx(1e-4 / 3 * np.eye(2))
    assert merged.bottom_m[0] == 0.5 and merged.quality.sightings[0] == 20
    assert len(duplicates(merged)) == 0


def test_a_command_merges_what_the_check_lists(tmp_path: Path) -> None:
    write_map(five(), tmp_path / "map.yaml")
    assert "There twice" in run("map", "check", tmp_path / "map.yaml").output
    shown = " ".join(run("map", "merge", tmp_path / "map.yaml", "-o", tmp_path / "better.yaml").output.split())
    assert "0 is part of 1" in shown and "3 landmarks" in shown and "2 were there twice" in shown
    assert len(read_map(tmp_path / "better.yaml")) == 3


def test_taking_landmarks_takes_their_quality_along() -> None:
    quality = replace(Quality.unknown(3), existence=np.array([0.1, 0.2, 0.3]))
    whole = replace(LandmarkMap.from_points(np.arange(6.0).reshape(3, 2), ids=("a", "b", "c")), quality=quality)
    part = whole.take(np.array([2, 0]))
    assert part.ids == ("c", "a") and part.points.tolist() == [[4.0, 5.0], [0.0, 1.0]]
    assert part.quality.existence.tolist() == [0.3, 0.1]


def test_a_landmark_whose_sigma_is_larger_than_any_distance_to_it_has_no_place() -> None:
    cameras = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]])
    points = np.array([[0.0, -2.0], [0.3, -4.0]])
    frames = []
    for camera in cameras:
        heading, _ = direction_of(points, np.tile(camera, (2, 1)))
        frames.append(Edges.from_bearings(wrap_angle(camera[2] - heading), 0.001))
    sightings = Sightings.from_edges(frames, Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(0.35, 0.9)))
    made = fit_landmarks(sightings, np.array([0, 1, 0, 1]), cameras, np.full(4, 0.001))
    assert is_placed(sightings, made, cameras, made.fit.cov).all()
    for sigma_m, expected in ((1.0, [True, True]), (3.0, [False, True]), (5.0, [False, False])):
        cov = np.tile(np.diag([1e-6, sigma_m**2]), (2, 1, 1))
        np.testing.assert_array_equal(is_placed(sightings, made, cameras, cov), expected)


def test_quality_of_landmarks_comes_back(tmp_path: Path) -> None:
    plain = LandmarkMap.from_points(np.array([[0.0, 1.0], [2.0, 3.0]]), name="built")
    quality = Quality(np.array([12.0, np.nan]), np.deg2rad([23.5, 7.25]), np.array([0.97, np.nan]))
    write_map(replace(plain, quality=quality), tmp_path / "map.yaml")
    found = read_map(tmp_path / "map.yaml").quality
    assert found is not None
    for name in ("sightings", "parallax_rad", "existence"):
        np.testing.assert_allclose(getattr(found, name), getattr(quality, name), atol=1e-6)
    write_map(plain, tmp_path / "plain.yaml")
    assert read_map(tmp_path / "plain.yaml").quality is None
