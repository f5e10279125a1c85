"""Constants of wheels by least squares against the truth, and how a run's own stand beside them."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from localiser.evaluate import bias_figures, fit_wheels
from localiser.geometry import Trajectory, arc_motion, compose
from localiser.particles import Estimate

SECOND = 1_000_000_000


def driven(distance_scale: float, turn_scale: float, veer: float, steps: int = 1200) -> Trajectory:
    """A robot at 10 Hz that drives curves both ways, and back now and then, with these constants."""
    rng = np.random.default_rng(3)
    speed = np.repeat(rng.uniform(-0.1, 0.5, steps // 20), 20) * 0.1
    turn = np.repeat(rng.uniform(-0.4, 0.4, steps // 20), 20) * 0.1
    poses = [np.array([1.0, 2.0, 3.0])]
    for ahead, angle in zip(speed, turn, strict=True):
        true = angle * (1 + turn_scale) + veer * ahead
        poses.append(compose(poses[-1], arc_motion(np.array([0.0, -ahead * (1 + distance_scale)]), true, 1.0)))
    return Trajectory(np.arange(steps + 1) * (SECOND // 10), np.array(poses))


@pytest.mark.parametrize("constants", [(0.0, 0.0, 0.0), (-0.05, 0.08, 0.03), (0.1, -0.1, -0.05)])
def test_the_constants_that_the_robot_has_are_found(constants: tuple[float, float, float]) -> None:
    found = fit_wheels(driven(0, 0, 0), driven(*constants), 0, 120 * SECOND)
    np.testing.assert_allclose(list(found.values()), constants, atol=0.005)


def test_only_what_odometry_and_truth_have_in_common_counts() -> None:
    odometry, truth = driven(0, 0, 0), driven(0.1, 0.1, 0)
    late = Trajectory(truth.t_ns[400:], truth.poses[400:])
    assert fit_wheels(odometry, late, 0, 200 * SECOND)["distance_scale"] == pytest.approx(0.1, abs=0.005)
    ended = Trajectory(odometry.t_ns[:800], odometry.poses[:800])
    assert fit_wheels(ended, truth, 0, 120 * SECOND) == fit_wheels(odometry, truth, 0, int(ended.t_ns[-1]))
    assert fit_wheels(odometry, truth, 0, 20 * SECOND) == {}, "too short"
    stood = Trajectory(odometry.t_ns, np.zeros_like(odometry.poses))
    assert fit_wheels(stood, truth, 0, 120 * SECOND) == {}


def test_a_clock_that_jumps_by_decades_costs_nothing() -> None:
    odometry, truth = driven(0, 0, 0), driven(0.1, 0.1, 0)
    decades = 30 * 365 * 86_400 * SECOND
    jumped = odometry.t_ns + np.where(odometry.t_ns > 60 * SECOND, decades, 0)
    tracemalloc.start()
    found = fit_wheels(Trajectory(jumped, odometry.poses), Trajectory(jumped, truth.poses), 0, int(jumped[-1]))
    most_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found["distance_scale"] == pytest.approx(0.1, abs=0.005)
    assert most_bytes < 2**22


def test_a_piece_without_truth_inside_does_not_count() -> None:
    odometry, truth = driven(0, 0, 0), driven(0.1, 0.1, 0)
    kept = (truth.t_ns < 40 * SECOND) | (truth.t_ns > 70 * SECOND)  # a straight line where the robot drove curves
    found = fit_wheels(odometry, Trajectory(truth.t_ns[kept], truth.poses[kept]), 0, 120 * SECOND)
    assert found["distance_scale"] == pytest.approx(0.1, abs=0.005)


def test_constants_that_cannot_be_wrong_are_left_out() -> None:
    names = ("x", "z", "heading", "distance_scale", "veer", "delay")
    estimate = Estimate(names, np.array([1, 2, 3, 0.01, 0.02, 0.0]), np.diag([1, 1, 1, 0.25, 0.04, 0.0]) ** 2)
    assert bias_figures(estimate, {"distance_scale": 0.015, "turn_scale": 0.1}) == {
        "distance_scale": {"value": 0.01, "sigma": 0.25, "least_squares": 0.015},
        "veer": {"value": 0.02, "sigma": 0.04},
    }
