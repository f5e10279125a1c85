"""A robot that is later than its odometry, as one that is told how fast to drive."""

from __future__ import annotations

from functools import reduce

import numpy as np

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.filter import FilterState, Located, Mcl, MclParameters, Odometry, Sighting, Start, step
from localiser.filter.moves import moves_between
from localiser.geometry import Array, Increment, Trajectory, arc_motion, between, compose
from localiser.landmarks import LandmarkMap, sight
from localiser.motion import MotionParameters
from localiser.motion.constant_errors import EXACT, ConstantErrorParameters
from localiser.observation import EdgeObservation, ObservationParameters

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
