"""Constant errors of wheels and mount: what a particle knows of them, against brute force and against the truth."""

from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
import pytest
from mrclam import MrclamReader
from numpy.typing import NDArray

from localiser import geometry, particles
from localiser.calibration import SCALES, Drive, fit_odometry
from localiser.camera import Camera, Mount
from localiser.config import read_config
from localiser.edges import Edges
from localiser.filter import FilterState, Located, Mcl, MclParameters, Odometry, Sighting, Start, mcl, step
from localiser.filter.events import moves_between
from localiser.geometry import Array, Increment, Trajectory, arc_motion, between, compose, wrap_angle
from localiser.landmarks import LandmarkMap, sight
from localiser.motion import EXACT, MotionParameters, covariance_of
from localiser.motion.odometry_model import CONSTANT_ERRORS, ConstantErrorParameters, forget
from localiser.observation import EdgeObservation, ObservationParameters
from localiser.particles import POSE, Particles
from localiser.replay.run import start_of
from localiser.storage.log import ReadOptions

WIDE = ConstantErrorParameters(
    distance_sigma=0.1, turn_sigma=0.1, veer_sigma_deg_per_m=3.0, delay_sigma_s=0.1, yaw_sigma_deg=1.0, memory_m=1e12
)
NOISE = MotionParameters(alpha1=1e-3, alpha2=5e-4, alpha3=5e-4, alpha4=1e-4, bias=WIDE)
CERTAIN = np.diag([0.01, 0.01, 0.005]) ** 2
SIGMA = np.sqrt(np.diag(WIDE.cov))
STEP_S = 0.5


def start(count: int, seed: int = 0, cov: Array = CERTAIN, mean: tuple[float, ...] = (0, 0, 0.3)) -> Particles:
    rng = np.random.default_rng(seed)
    return NOISE.at_start(particles.from_gaussian(np.array(mean), cov, count, rng), rng)


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
        cloud = NOISE.predict(cloud, increment, rng)
    found = cloud.estimate
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
    after = none.predict(replace(still, columns=columns), Increment.from_mean([0, -1.0, 0]), np.random.default_rng(0))
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
            cloud = NOISE.predict(cloud, increment, rng)
            seen = cloud.poses + np.stack([0 * cloud["x"], 0 * cloud["x"], cloud["camera_yaw"]], axis=1)
            off = seen - camera
            off[:, 2] = wrap_angle(off[:, 2])
            cloud = replace(cloud, log_weight=cloud.log_weight - 0.5 * np.square(off / measured_sigma).sum(axis=1))
            found = cloud.estimate
            if particles.effective_sample_size(cloud.weight) < 250:
                cloud = particles.take(cloud, np.sort(rng.choice(500, 500, p=cloud.weight)))
        error = found.mean[3:] - bias
        squared.append(error @ np.linalg.solve(found.cov[3:, 3:], error) / 5)
    assert (np.sqrt(np.diag(found.cov[3:, 3:])) < SIGMA * [0.25, 0.25, 0.4, 0.4, 0.5]).all()
    assert 0.4 < np.mean(squared) < 2.0


def test_a_robot_that_stands_learns_nothing_and_one_that_turns_nothing_of_its_distance() -> None:
    cloud = start(50)
    stood = NOISE.predict(cloud, Increment.from_mean(np.zeros(3)), np.random.default_rng(0))
    np.testing.assert_allclose(stood.constant_error_cov, cloud.constant_error_cov, atol=1e-15)
    np.testing.assert_allclose(stood.columns, cloud.columns, atol=1e-12)
    turned = NOISE.predict(cloud, Increment.from_mean([0, 0, 1.0]), np.random.default_rng(0))
    np.testing.assert_allclose(np.diag(turned.constant_error_cov)[[0, 2]], np.diag(cloud.constant_error_cov)[[0, 2]])
    assert turned.constant_error_cov[1, 1] < cloud.constant_error_cov[1, 1]


@pytest.mark.parametrize("heading_sigma", [0.0, 0.02, 1e3])
def test_a_start_says_of_the_robots_heading_what_it_said_and_of_the_yaw_the_prior(heading_sigma: float) -> None:
    around = heading_sigma > np.pi
    cloud = start(40_000, cov=np.diag([0.01, 0.01, heading_sigma]) ** 2)
    found = cloud.estimate
    np.testing.assert_allclose(np.diag(found.cov)[3:], SIGMA**2, rtol=0.03)
    if not around:
        np.testing.assert_allclose(found.cov[2, 2], heading_sigma**2, rtol=0.03, atol=1e-12)
        assert abs(found.cov[2, 7]) < 0.02 * heading_sigma * SIGMA[4] + 1e-12


def test_an_estimate_is_forgotten_towards_the_prior_the_cameras_heading_staying_as_it_was() -> None:
    rng = np.random.default_rng(2)
    columns = np.vstack([start(100).columns[:3], rng.standard_normal((5, 100)) * SIGMA[:, None]])
    later, in_pieces, parameters = columns.copy(), columns.copy(), replace(WIDE, memory_m=20.0)
    cov = forget(later, np.zeros((5, 5)), 20.0, parameters)
    np.testing.assert_allclose(later[3:], columns[3:] / np.e)
    np.testing.assert_allclose(cov, (1 - np.exp(-2)) * WIDE.cov)
    turned = wrap_angle(later[2] + later[-1] - columns[2] - columns[-1])  # the camera's heading
    np.testing.assert_allclose(turned, 0, atol=1e-12)
    cov_in_pieces = np.zeros((5, 5))
    for _ in range(10):
        cov_in_pieces = forget(in_pieces, cov_in_pieces, 2.0, parameters)
    np.testing.assert_allclose(in_pieces, later, atol=1e-12)
    np.testing.assert_allclose(cov_in_pieces, cov, atol=1e-12)


def test_steps_never_put_constant_errors_in_more_doubt_than_the_prior() -> None:
    cloud, rng = start(500), np.random.default_rng(0)
    for increment in drive(60):
        cloud = NOISE.predict(cloud, increment, rng)
        off = wrap_angle(cloud["heading"] - np.median(cloud["heading"]))
        cloud = particles.take(cloud, rng.choice(500, 500, p=off**2 / (off**2).sum()))  # as by two peaks
        doubt = cloud.constant_error_cov / np.outer(SIGMA, SIGMA)
        assert np.linalg.eigvalsh(doubt)[-1] <= 1.0 + 1e-9


def test_what_vision_measured_tells_nothing_of_the_wheels() -> None:
    increment = Increment.from_mean([0, -0.5, 0.1], np.diag([0.01, 0.01, 0.01]) ** 2)
    cloud = start(50)
    after = NOISE.predict(cloud, increment, np.random.default_rng(0))
    np.testing.assert_allclose(after.columns[3:], cloud.columns[3:])
    np.testing.assert_allclose(after.constant_error_cov, cloud.constant_error_cov)


def test_the_covariance_of_wheels_alone_holds_what_their_biases_may_do() -> None:
    """2 m ahead: 10 % of it along the way, 3° per metre of turn, half of which comes before the way."""
    sure = replace(NOISE, alpha1=0.0, alpha2=0.0, alpha3=0.0, alpha4=0.0)
    cov = covariance_of(sure, Increment.from_mean([0, -2.0, 0]))
    veer = np.deg2rad(3.0)
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), [2 * veer, 0.2, 2 * veer], atol=1e-12)


def test_biases_that_cannot_be_wrong_stay_nought() -> None:
    sure = ConstantErrorParameters(0.0, 0.0, 0.0, 0.0, 0.0)
    rng = np.random.default_rng(3)
    motion = replace(NOISE, bias=sure)
    cloud = motion.at_start(particles.from_gaussian(np.zeros(3), CERTAIN, 20, rng), rng)
    for increment in drive(5):
        cloud = motion.predict(cloud, increment, rng)
    np.testing.assert_allclose(cloud.columns[3:], 0, atol=1e-15)
    np.testing.assert_allclose(cloud.constant_error_cov, 0, atol=1e-18)


def test_an_estimate_says_from_where_its_camera_sees() -> None:
    found = particles.Estimate(
        (*POSE, *CONSTANT_ERRORS), np.array([1.0, 2.0, 0.3, 0.01, 0.02, 0.03, 0.04, 0.05]), np.eye(8)
    )
    np.testing.assert_allclose(found.as_seen.pose, [1.0, 2.0, 0.35])
    turned = np.eye(8) - 0.4 * (np.eye(8, k=5) + np.eye(8, k=-5))
    np.testing.assert_allclose(replace(found, cov=turned).as_seen.cov, np.diag([1.0, 1.0, 1.0 + 1.0 - 2 * 0.4]))
    np.testing.assert_allclose(particles.Estimate(POSE, found.mean[:3], np.eye(3)).as_seen.pose, [1.0, 2.0, 0.3])


KNOWN = ["observation.association=known", "motion.bias.delay_sigma_s=0.2"]


def likeliest_delay(odometry: Trajectory, truth: Trajectory, from_ns: int, until_ns: int) -> float:
    """By how much later (s) than commanded turns are made, so that turns of 1 s are predicted best."""
    times = np.arange(from_ns, until_ns, 1_000_000_000)
    true = turns(truth, times)
    delays = np.arange(0.0, 0.41, 0.04)
    misfit = [np.linalg.lstsq(turns(odometry, times - int(1e9 * delay))[:, None], true)[1][0] for delay in delays]
    return float(delays[np.argmin(misfit)])


def turns(track: Trajectory, times: NDArray[np.int64]) -> Array:
    return np.asarray(geometry.wrap_angle(np.diff(track.sampled(times).poses[:, 2])))


@pytest.mark.data
@pytest.mark.slow
def test_wheels_of_a_real_robot_are_learnt_and_it_is_located_within_its_sigmas(data_dir: Path) -> None:
    log = MrclamReader().read(data_dir / "mrclam:1", ReadOptions())
    config = read_config(None, KNOWN, log.settings)
    assert log.landmark_map is not None
    rng = np.random.default_rng(0)
    filter_ = mcl.Mcl(
        log.landmark_map, EdgeObservation(log.camera, config.observation), config.mcl, config.motion, config.observation
    )
    state = mcl.FilterState()
    found = [one for event in log.events(start_of(log, "truth", rng)) for one in mcl.step(filter_, state, event, rng)]
    between = found[0].t_ns, found[-1].t_ns
    truth = log.groundtruth.sampled([one.t_ns for one in found]).poses
    error: Array = np.array([one.estimate.pose for one in found]) - truth
    error[:, 2] = geometry.wrap_angle(error[:, 2])
    position_m = np.hypot(error[:, 0], error[:, 1])
    assert np.median(position_m) < 0.12
    assert np.sqrt(np.mean(position_m**2)) < 0.25

    fit = fit_odometry([Drive("robot", log.odometry, log.groundtruth)], config.motion)
    estimate, by_truth = found[-1].estimate, dict(zip(SCALES, fit.constants[0], strict=True))
    learnt = dict(zip(estimate.names, estimate.mean, strict=True))
    assert abs(by_truth["turn_scale"]) > 0.03, "wheels that are right would show nothing"
    assert abs(learnt["turn_scale"] - by_truth["turn_scale"]) < 0.05
    assert abs(learnt["distance_scale"] - by_truth["distance_scale"]) < 0.05
    assert abs(learnt["delay"] - likeliest_delay(log.odometry, log.groundtruth, *between)) < 0.08
    delay = estimate.names.index("delay")
    assert estimate.cov[delay, delay] < 0.08**2


SECOND = 1_000_000_000
LATE_S = 0.15
CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.radians(20), 0.9))
SIGMA_RAD = np.radians(0.3)
START = np.diag([0.05, 0.05, 0.02]) ** 2


def commanded(seconds: int) -> Trajectory:
    """What a robot at 20 Hz is told: another turn every half a second."""
    rng = np.random.default_rng(5)
    turn = np.repeat(rng.uniform(-1, 1, 2 * seconds), 10) * 0.05
    poses = [np.zeros(3)]
    for angle in turn:
        poses.append(compose(poses[-1], arc_motion(np.array([0.0, -0.3 * 0.05]), angle, 1.0)))
    return Trajectory(np.arange(len(poses)) * (SECOND // 20), np.array(poses))


def wheels(track: Trajectory) -> list[Odometry]:
    return [Odometry(int(t_ns), pose) for t_ns, pose in zip(track.t_ns, track.poses, strict=True)]


def later(track: Trajectory, delay_s: float) -> Trajectory:
    return Trajectory(track.t_ns + round(delay_s * SECOND), track.poses)


def test_increments_say_what_a_later_robot_would_have_done_all_along() -> None:
    """Image by image, also over long moves, though the odometry that is past is forgotten."""
    track, state = commanded(20), FilterState()
    state.odometry.extend(wheels(track))
    for t_ns in (SECOND, 5 * SECOND // 4, 3 * SECOND // 2, 11 * SECOND, 12 * SECOND):
        start_ns = state.at_ns
        moves, *_ = moves_between(state.odometry, start_ns, t_ns, LATE_S)
        late = [Increment.from_mean(move.mean + LATE_S * move.by_delay) for move in moves]
        expected = between(*later(track, LATE_S).sampled([start_ns, t_ns]).poses)
        np.testing.assert_allclose(reduce(Increment.then, late).mean, expected, atol=1e-9)
        step_ = reduce(Increment.then, moves)
        small = reduce(Increment.then, [Increment.from_mean(move.mean + 1e-6 * move.by_delay) for move in moves]).mean
        np.testing.assert_allclose((small - step_.mean) / 1e-6, step_.by_delay, atol=1e-5)
        state.at_ns = t_ns
    assert state.odometry[0].t_ns <= 12 * SECOND - LATE_S * SECOND
    assert len(state.odometry) < 170, "what is past is forgotten"


def test_of_a_robot_that_cannot_be_late_nothing_is_said() -> None:
    state = FilterState()
    state.odometry.extend(wheels(commanded(3)))
    moves, *_ = moves_between(state.odometry, 0, 2 * SECOND)
    assert not any(move.by_delay.any() for move in moves)


def located(bias: ConstantErrorParameters) -> tuple[list[Located], Array]:
    """Follow a robot among landmarks that does 0.15 s later what it is told; return also its true poses."""
    rng = np.random.default_rng(0)
    odometry = commanded(20)
    truth = later(odometry, LATE_S)
    angle = np.arange(0, 2 * np.pi, 0.2)
    points = odometry.poses[:, :2].mean(axis=0) + 8 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    landmark_map = LandmarkMap.from_points(points)
    parameters = ObservationParameters(landmark_sigma_m=0.0, decorrelation_m=0.0)
    mcl = Mcl(
        landmark_map,
        EdgeObservation(CAMERA, parameters),
        MclParameters(particles=300, start_particles=300),
        MotionParameters(alpha1=1e-4, alpha2=1e-4, alpha3=1e-4, alpha4=1e-5, bias=bias),
        parameters,
    )
    state, found, true = FilterState(), [], []
    list(step(mcl, state, Start(0, np.zeros(3), START), rng))
    waiting = iter(wheels(odometry))
    for t_ns in range(SECOND // 5, 19 * SECOND, SECOND // 5):
        true.append(truth.at(t_ns))
        tangent = sight(CAMERA, true[-1][None], landmark_map).tangent
        bearing = np.arctan(tangent) + rng.normal(0, SIGMA_RAD, len(tangent))
        nothing = np.full(len(bearing), np.nan)
        edges = Edges.from_columns(bearing, np.full(len(bearing), SIGMA_RAD), nothing, nothing)
        found += step(mcl, state, Sighting(t_ns, edges), rng)
        for event in waiting:
            found += step(mcl, state, event, rng)
            if event.t_ns >= t_ns:
                break
    return found, np.array(true)


def test_a_robot_that_is_late_is_found_to_be_and_followed_better_for_it() -> None:
    found, truth = located(ConstantErrorParameters(0.0, 0.0, 0.0, delay_sigma_s=0.2, yaw_sigma_deg=0.0))
    last = found[-1].estimate
    row = last.names.index("delay")
    sigma = np.sqrt(last.cov[row, row])
    assert sigma < 0.02
    assert abs(last.mean[row] - LATE_S) < 3 * sigma

    def rmse_rad(run: list[Located]) -> float:
        return float(
            np.sqrt(np.mean([(one.estimate.pose[2] - true[2]) ** 2 for one, true in zip(run, truth, strict=True)]))
        )

    assert rmse_rad(found) < 0.8 * rmse_rad(located(EXACT)[0])
