"""Constant errors of wheels and mount: what a particle knows of them, against brute force and against the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localiser import particles
from localiser.geometry import Array, Increment, arc_motion, between, compose, wrap_angle
from localiser.motion import MotionParameters, predict, wheel_cov
from localiser.motion.constant_errors import CONSTANT_ERRORS, ConstantErrorParameters, at_start, forgotten
from localiser.particles import POSE, Particles

WIDE = ConstantErrorParameters(
    distance_sigma=0.1, turn_sigma=0.1, veer_sigma_deg_per_m=3.0, delay_sigma_s=0.1, yaw_sigma_deg=1.0, memory_m=1e12
)
NOISE = MotionParameters(alpha1=1e-3, alpha2=5e-4, alpha3=5e-4, alpha4=1e-4, bias=WIDE)
CERTAIN = np.diag([0.01, 0.01, 0.005]) ** 2
SIGMA = np.sqrt(np.diag(WIDE.cov))
STEP_S = 0.5


def start(count: int, seed: int = 0, cov: Array = CERTAIN, mean: tuple[float, ...] = (0, 0, 0.3)) -> Particles:
    rng = np.random.default_rng(seed)
    return at_start(particles.from_gaussian(np.array(mean), cov, count, rng), WIDE, rng)


def drive(count: int) -> list[Increment]:
    """Straights and curves both ways, a turn on the spot, and some way back."""
    moves = [[(0.0, -0.1), 0.0], [(0.0, -0.1), 0.06], [(0.0, 0.0), -0.2], [(0.0, -0.12), -0.05], [(0.0, 0.06), 0.0]]
    means = [arc_motion(np.array(moves[k % 5][0]), moves[k % 5][1], 1.0) for k in range(count)]
    return [
        replace(Increment.from_mean(mean), by_delay=(before - mean) / STEP_S)
        for mean, before in zip(means, [np.zeros(3), *means], strict=False)
    ]


def driven(poses: Array, biases: Array, increments: list[Increment], rng: np.random.Generator) -> Array:
    """Poses (N, 3) of robots with these biases (5, N), by brute force: scaled, turned by veer, late, and noise."""
    scale, turn_scale, veer, delay, _ = biases
    for increment in increments:
        ahead, turn = -increment.mean[1] / np.cos(increment.mean[2] / 2), increment.mean[2]
        distance_var = NOISE.alpha3 * increment.path_m + NOISE.alpha4 * increment.turned_rad
        turn_var = NOISE.alpha1 * increment.turned_rad + NOISE.alpha2 * increment.path_m
        along, left, before, after = rng.standard_normal((4, len(poses))) * np.sqrt(
            [[distance_var], [0.01 * distance_var], [turn_var / 2], [turn_var / 2]]
        )
        more = turn_scale * turn + veer * ahead
        first = turn / 2 + more / 2 + before
        poses = compose(poses, np.stack([0 * first, 0 * first, first], axis=1))
        late = between([0, 0, turn / 2], compose([0, 0, 0], increment.by_delay))[:, None] * delay
        late[2] = increment.by_delay[2] * delay
        right, back, rest = -left, -(ahead * (1 + scale) + along), turn + more - first + before + after
        poses = compose(poses, np.stack([right + late[0], back + late[1], rest + late[2]], 1))
    return poses


def test_what_is_known_after_a_way_that_nobody_saw_is_what_brute_force_says() -> None:
    """Draw robots with biases from the prior and drive them: mean and covariance of poses and biases are the same."""
    count, increments = 100_000, drive(15)
    rng = np.random.default_rng(1)
    poses = np.array([0, 0, 0.3]) + rng.standard_normal((count, 3)) * np.sqrt(np.diag(CERTAIN))
    biases = SIGMA[:, None] * rng.standard_normal((5, count))
    poses = driven(poses, biases, increments, rng)
    expected = np.vstack([poses.T, biases])
    expected[2] = wrap_angle(expected[2] - 0.3) + 0.3

    cloud = start(count)
    for increment in increments:
        cloud = predict(cloud, increment, NOISE, rng)
    found = particles.estimate(cloud)
    assert found.names == (*POSE, *CONSTANT_ERRORS)
    sigma = expected.std(axis=1)
    np.testing.assert_allclose((found.mean - expected.mean(axis=1)) / sigma, 0, atol=0.03)
    np.testing.assert_allclose(found.cov / np.outer(sigma, sigma), np.corrcoef(expected), atol=0.03)


def test_the_camera_is_carried_where_its_own_yaw_says() -> None:
    """A robot that drives straight on, whose camera looks 2° to the left: its camera moves 2° to the right of ahead."""
    still = Particles((*POSE, *CONSTANT_ERRORS), np.zeros((8, 5)), np.zeros(5), constant_error_cov=np.zeros((5, 5)))
    columns = still.columns.copy()
    columns[2], columns[7] = 0.1, np.deg2rad(2.0)
    none = MotionParameters(0.0, 0.0, 0.0, 0.0, bias=WIDE)
    after = predict(replace(still, columns=columns), Increment.from_mean([0, -1.0, 0]), none, np.random.default_rng(0))
    np.testing.assert_allclose(after["x"], -np.sin(0.1), atol=1e-3)
    np.testing.assert_allclose(after["z"], -np.cos(0.1), atol=1e-3)
    np.testing.assert_allclose(after["heading"], 0.1, atol=1e-12)


@pytest.mark.slow
def test_biases_are_learnt_from_where_the_camera_is_seen_and_their_sigmas_are_honest() -> None:
    """Camera poses measured within 1 cm and 0.3° along 24 m: all five become known as well as the filter says."""
    increments, measured_sigma = drive(300), np.array([0.01, 0.01, 0.005])
    squared = []
    for seed in range(12):
        rng = np.random.default_rng([7, seed])
        bias = SIGMA * rng.standard_normal(5)[[0, 1, 2, 4, 3]]
        pose, cloud = np.array([[0.0, 0.0, 0.3]]), start(500, seed)
        for increment in increments:
            pose = driven(pose, bias[:, None], [increment], rng)
            camera = pose[0] + [0, 0, bias[4]] + measured_sigma * rng.standard_normal(3)
            cloud = predict(cloud, increment, NOISE, rng)
            seen = cloud.poses + np.stack([0 * cloud["x"], 0 * cloud["x"], cloud["camera_yaw"]], axis=1)
            off = seen - camera
            off[:, 2] = wrap_angle(off[:, 2])
            cloud = replace(cloud, log_weight=cloud.log_weight - 0.5 * np.square(off / measured_sigma).sum(axis=1))
            found = particles.estimate(cloud)
            if particles.effective_sample_size(cloud.weight) < 250:
                cloud = particles.take(cloud, np.sort(rng.choice(500, 500, p=cloud.weight)))
        error = found.mean[3:] - bias
        squared.append(error @ np.linalg.solve(found.cov[3:, 3:], error) / 5)
    assert (np.sqrt(np.diag(found.cov[3:, 3:])) < SIGMA * [0.25, 0.25, 0.4, 0.4, 0.5]).all()
    assert 0.4 < np.mean(squared) < 2.0


def test_a_robot_that_stands_learns_nothing_and_one_that_turns_nothing_of_its_distance() -> None:
    cloud = start(50)
    stood = predict(cloud, Increment.from_mean(np.zeros(3)), NOISE, np.random.default_rng(0))
    np.testing.assert_allclose(stood.constant_error_cov, cloud.constant_error_cov, atol=1e-15)
    np.testing.assert_allclose(stood.columns, cloud.columns, atol=1e-12)
    turned = predict(cloud, Increment.from_mean([0, 0, 1.0]), NOISE, np.random.default_rng(0))
    np.testing.assert_allclose(np.diag(turned.constant_error_cov)[[0, 2]], np.diag(cloud.constant_error_cov)[[0, 2]])
    assert turned.constant_error_cov[1, 1] < cloud.constant_error_cov[1, 1]


@pytest.mark.parametrize("heading_sigma", [0.0, 0.02, 1e3])
def test_a_start_says_of_the_robots_heading_what_it_said_and_of_the_yaw_the_prior(heading_sigma: float) -> None:
    around = heading_sigma > np.pi
    cloud = start(40_000, cov=np.diag([0.01, 0.01, heading_sigma]) ** 2)
    found = particles.estimate(cloud)
    np.testing.assert_allclose(np.diag(found.cov)[3:], SIGMA**2, rtol=0.03)
    if not around:
        np.testing.assert_allclose(found.cov[2, 2], heading_sigma**2, rtol=0.03, atol=1e-12)
        assert abs(found.cov[2, 7]) < 0.02 * heading_sigma * SIGMA[4] + 1e-12


def test_an_estimate_is_forgotten_towards_the_prior_the_cameras_heading_staying_as_it_was() -> None:
    rng = np.random.default_rng(2)
    cloud = replace(start(100), constant_error_cov=np.zeros((5, 5)))
    cloud = replace(cloud, columns=np.vstack([cloud.columns[:3], rng.standard_normal((5, 100)) * SIGMA[:, None]]))
    parameters = replace(WIDE, memory_m=20.0)
    later = forgotten(cloud, 20.0, parameters)
    np.testing.assert_allclose(later.columns[3:], cloud.columns[3:] / np.e)
    np.testing.assert_allclose(later.constant_error_cov, (1 - np.exp(-2)) * WIDE.cov)
    turned = wrap_angle(later["heading"] + later["camera_yaw"] - cloud["heading"] - cloud["camera_yaw"])
    np.testing.assert_allclose(turned, 0, atol=1e-12)
    in_pieces = cloud
    for _ in range(10):
        in_pieces = forgotten(in_pieces, 2.0, parameters)
    np.testing.assert_allclose(in_pieces.columns, later.columns, atol=1e-12)
    np.testing.assert_allclose(in_pieces.constant_error_cov, later.constant_error_cov, atol=1e-12)


def test_what_vision_measured_tells_nothing_of_the_wheels() -> None:
    increment = Increment.from_mean([0, -0.5, 0.1], np.diag([0.01, 0.01, 0.01]) ** 2)
    cloud = start(50)
    after = predict(cloud, increment, NOISE, np.random.default_rng(0))
    np.testing.assert_allclose(after.columns[3:], cloud.columns[3:])
    np.testing.assert_allclose(after.constant_error_cov, cloud.constant_error_cov)


def test_the_covariance_of_wheels_alone_holds_what_their_biases_may_do() -> None:
    """2 m ahead: 10 % of it along the way, 3° per metre of turn, half of which comes before the way."""
    cov = wheel_cov(Increment.from_mean([0, -2.0, 0]), replace(NOISE, alpha1=0.0, alpha2=0.0, alpha3=0.0, alpha4=0.0))
    veer = np.deg2rad(3.0)
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), [2 * veer, 0.2, 2 * veer], atol=1e-12)


def test_biases_that_cannot_be_wrong_stay_nought() -> None:
    sure = ConstantErrorParameters(0.0, 0.0, 0.0, 0.0, 0.0)
    rng = np.random.default_rng(3)
    cloud = at_start(particles.from_gaussian(np.zeros(3), CERTAIN, 20, rng), sure, rng)
    for increment in drive(5):
        cloud = predict(cloud, increment, replace(NOISE, bias=sure), rng)
    np.testing.assert_allclose(cloud.columns[3:], 0, atol=1e-15)
    np.testing.assert_allclose(cloud.constant_error_cov, 0, atol=1e-18)


def test_an_estimate_says_from_where_its_camera_sees() -> None:
    found = particles.Estimate(
        (*POSE, *CONSTANT_ERRORS), np.array([1.0, 2.0, 0.3, 0.01, 0.02, 0.03, 0.04, 0.05]), np.eye(8)
    )
    np.testing.assert_allclose(found.pose_as_seen, [1.0, 2.0, 0.35])
    np.testing.assert_allclose(particles.Estimate(POSE, found.mean[:3], np.eye(3)).pose_as_seen, [1.0, 2.0, 0.3])
