"""The scenarios of benchmarks/robustness.py are what they say they are, and so are its intervals."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from folders import ROOT

from localiser import geometry
from localiser.geometry import Trajectory
from localiser.landmarks import in_camera
from localiser.simulate.robot import OdometrySpec

BENCHMARKS = ROOT / "benchmarks"


@pytest.fixture(scope="module")
def benchmarks() -> Iterator[dict[str, Any]]:
    """Return the modules of the benchmark, which is not a package."""
    sys.path.insert(0, str(BENCHMARKS))
    import intervals
    import scenarios

    yield {"intervals": intervals, "scenarios": scenarios}
    sys.path.remove(str(BENCHMARKS))


# -- intervals --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("passed", "count", "low", "high"),  # [Newcombe 1998, table I], to four digits
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_is_that_of_the_literature(
    benchmarks: dict[str, Any], passed: int, count: int, low: float, high: float
) -> None:
    share, *interval = benchmarks["intervals"].wilson(passed, count)
    assert share == passed / count
    assert interval == pytest.approx([low, high], abs=6e-5)
    mirrored = benchmarks["intervals"].wilson(count - passed, count)
    assert mirrored[1:] == pytest.approx((1 - high, 1 - low), abs=6e-5)


@pytest.mark.parametrize(("count", "bound"), [(0, 2.996), (1, 4.744), (5, 10.513)])  # chi-squared table, halved
def test_rate_bound_is_that_of_the_literature(benchmarks: dict[str, Any], count: int, bound: float) -> None:
    assert benchmarks["intervals"].rate_bound(count, 1.0) == pytest.approx(bound, abs=1e-3)
    assert benchmarks["intervals"].rate_bound(count, 10.0) == pytest.approx(bound / 10, abs=1e-4)


def test_frames_of_one_seed_count_together(benchmarks: dict[str, Any]) -> None:
    """Ten seeds, one of them bad throughout: the interval is that of ten draws, not of a thousand."""
    hits, frames = np.array([100, *[0] * 9]), np.full(10, 100)
    share, low, high = benchmarks["intervals"].share_of_frames(hits, frames)
    assert (share, low) == (0.1, 0.0)
    assert 0.25 < high < 0.35


# -- scenarios --------------------------------------------------------------------------------------------------------


@pytest.mark.slow  # quick: the other tests of this file
def test_empty_corridor_shows_at_most_two_landmarks_for_ten_metres(benchmarks: dict[str, Any]) -> None:
    one, again, other = (benchmarks["scenarios"].empty(seed) for seed in (3, 3, 4))
    mapped = [int((edges.landmark_id >= 0).sum()) for edges in one.frames]
    assert max(mapped[: one.judged]) > 5
    assert max(mapped[one.judged :]) <= 2 and np.mean(mapped[one.judged :]) > 0
    step_m = np.hypot(*np.diff(one.truth.poses[one.judged :, :2], axis=0).T)
    assert step_m.sum() == pytest.approx(10.0, abs=0.2)
    for edges, same in zip(one.frames, again.frames, strict=True):
        np.testing.assert_array_equal(edges.bearing, same.bearing)
    assert len(one.frames[0]) != len(other.frames[0]) or not np.array_equal(
        one.frames[0].bearing, other.frames[0].bearing
    )
    # The landmark ids are indices into the map that the filter gets.
    pose = one.truth.poses[0][None]
    right, ahead = (axis[0] for axis in in_camera(one.camera.pose_in_map(pose), one.landmark_map.points))
    known = one.frames[0].landmark_id >= 0
    seen = one.frames[0].landmark_id[known]
    error = one.frames[0].bearing[known] - np.arctan2(right[seen], ahead[seen])
    assert np.abs(error / one.frames[0].bearing_sigma[known]).max() < 5


def test_spines_stand_in_even_rows_along_walls(benchmarks: dict[str, Any]) -> None:
    scenarios = benchmarks["scenarios"]
    world = scenarios.place_of("corridor", 0, both_ways=False).world
    spines, shelf = scenarios.spines_of(world, 6, np.random.default_rng(0))
    assert set(shelf) == set(range(6))
    for number in range(6):
        points = spines.points[shelf == number]
        steps = np.diff(points, axis=0)
        np.testing.assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), atol=1e-9)
        assert 0.02 <= np.hypot(*steps[0]) <= 0.06
    assert ((spines.top_m - spines.bottom_m) > 0.15).all()


def test_wheels_do_not_notice_that_the_robot_is_carried(benchmarks: dict[str, Any]) -> None:
    """Without errors they give the motion of both parts exactly, and none in between."""
    rng = np.random.default_rng(0)
    parts = [np.cumsum(np.c_[np.zeros(5), -0.1 * np.ones(5), 0.05 * np.ones(5)], axis=0) for _ in range(2)]
    parts[1] = geometry.compose(np.array([4.0, 2.0, 2.5]), parts[1])
    truth = Trajectory(np.arange(10) * 200_000_000, np.concatenate(parts))
    wheels = benchmarks["scenarios"].odometry_of_trial(truth, OdometrySpec(), 5, rng).poses
    moved, driven = (geometry.between(poses[:-1], poses[1:]) for poses in (truth.poses, wheels))
    np.testing.assert_allclose(np.delete(driven, 4, axis=0), np.delete(moved, 4, axis=0), atol=1e-9)
    np.testing.assert_allclose(driven[4], 0.0, atol=1e-12)
    assert np.hypot(*moved[4][:2]) > 2
