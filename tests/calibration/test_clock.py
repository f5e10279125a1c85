"""The offset between the clocks of images and wheels, and the errors of odometry."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from folders import ROOT

from localiser.calibration import (
    ALPHAS,
    ClockOffset,
    Drive,
    Pieces,
    clock_offset,
    fit_odometry,
    on_one_clock,
    smooth_path,
)
from localiser.calibration.clock import REACH_S, offset_of_turns
from localiser.edges import Edges, find_edges
from localiser.geometry import Increment, Trajectory, between, compose
from localiser.motion import EXACT, MotionParameters, linearised
from localiser.storage import Log, open_log


def offset_of(log: Log, edges_of, shift_s: float) -> ClockOffset:
    """Return the offset that is found when the images of a log are stamped later by a shift."""
    times = [frame.t_ns + round(shift_s * 1e9) for frame in log.frames]
    return clock_offset(times, edges_of, log.odometry, log.camera)


@cache
def drive_with_edges(folder: Path):
    """Return a log, and what gives its edges, for all offsets that are looked for in it."""
    log = open_log(folder)
    return log, seen_by(log)


def seen_by(log: Log):
    """Return what gives the edges of an image of a log by its index, found once."""
    return cache(lambda index: find_edges(log.frames[index].load(), log.camera))


def drive(turned_deg: float, seed: int = 0, noise: float = 0.02) -> tuple[np.ndarray, np.ndarray, Trajectory]:
    """Return times (P, 2) of pairs, turns (P, 2) by edges, and wheels with noise, of a drive of 60 s with six turns."""
    rng = np.random.default_rng(seed)
    t_ns = np.arange(1201) * 50_000_000
    rate = np.zeros(1200)
    for begin in range(100, 1200, 200):
        rate[begin : begin + 40] = np.deg2rad(turned_deg / 6) / 2.0 * (-1) ** (begin // 200)
    true = np.concatenate([[0.0], np.cumsum(rate * 0.05)])
    wheels = np.concatenate([[0.0], np.cumsum(rate * 0.05 * 1.01 + noise * np.sqrt(0.01) * rng.normal(size=1200))])
    poses = np.stack([np.zeros(1201), -0.01 * np.arange(1201), wheels], axis=-1)
    images = np.arange(20, 1180, 4)
    times = np.stack([t_ns[images[:-1]], t_ns[images[1:]]], axis=-1)
    sigma = np.full(len(times), 5e-4)
    turns = np.diff(true[images]) + sigma * rng.normal(size=len(times))
    return times, np.stack([turns, sigma], axis=-1), Trajectory(t_ns, poses)


@pytest.fixture(scope="module")
def corridor() -> Log:
    return open_log(ROOT / "logs" / "corridor")


@pytest.fixture(scope="module")
def corridor_edges(corridor):
    return seen_by(corridor)


@pytest.mark.parametrize(
    "shift_s", [-0.5, 0.3, *(pytest.param(each, marks=pytest.mark.slow) for each in (-0.15, 0.0, 0.5))]
)
def test_the_corridor_s_clocks_are_compared_to_10_ms(corridor, corridor_edges, shift_s):
    found = offset_of(corridor, corridor_edges, shift_s)
    assert found.turned_rad > np.pi
    assert abs(found.offset_s - shift_s) < 0.010
    assert abs(found.offset_s - shift_s) < 3 * found.sigma_s < 0.05
    assert found.disagrees() == (shift_s != 0.0)
    assert (found.warning(Path("drive")) is None) == (shift_s == 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("shift_s", [-0.5, 0.2, 0.5])
@pytest.mark.parametrize("name", ["house", "bookstore"])
def test_clocks_of_other_drives_are_compared(data_dir, name, shift_s):
    found = offset_of(*drive_with_edges(data_dir / name), shift_s)
    assert abs(found.offset_s - shift_s) < 0.010
    assert abs(found.offset_s - shift_s) < 3 * found.sigma_s


@pytest.mark.parametrize("turned_deg", [60.0, 180.0, pytest.param(540.0, marks=pytest.mark.slow)])
def test_errors_agree_with_their_sigma(turned_deg):
    found = [offset_of_turns(*drive(turned_deg, seed)) for seed in range(8)]
    error, sigma = (np.array([getattr(one, name) for one in found]) for name in ("offset_s", "sigma_s"))
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 1.5
    assert np.abs(error / sigma).max() < 3.3 and np.median(sigma) < 3.0 / turned_deg
    if turned_deg >= 180:
        assert np.abs(error).max() < 0.010


@pytest.mark.parametrize("turned_deg", [0.0, 6.0, 12.0])
@pytest.mark.parametrize("seed", range(2))
def test_a_drive_without_turns_tells_nothing_and_says_so(turned_deg, seed):
    found = offset_of_turns(*drive(turned_deg, seed))
    assert found.sigma_s > 0.3 * REACH_S
    assert not found.disagrees() and "turns" in found.problem


def test_slipping_wheels_do_not_move_the_offset():
    times, turns, wheels = drive(540.0)
    poses = wheels.poses.copy()
    poses[:, 2] += np.clip((np.arange(1201) - 700) * 0.02, 0.0, 0.6)  # 34° in 1.5 s that the robot did not turn
    found = offset_of_turns(times, turns, Trajectory(wheels.t_ns, poses))
    assert abs(found.offset_s) < 0.015 and abs(found.offset_s) < 3 * found.sigma_s


@pytest.mark.parametrize("images", [0, 1, 2, 30])
def test_a_log_that_is_too_short_tells_nothing(images, corridor):
    t_ns = np.arange(images) * 50_000_000
    wheels = Trajectory(np.arange(40) * 50_000_000, np.zeros((40, 3)))  # 2 s: no pair can be moved by a second
    found = clock_offset(t_ns, lambda _: Edges.none(), wheels, corridor.camera)
    assert found.pairs == 0 and found.sigma_s > 0.5 and not found.disagrees()


NOISE = MotionParameters(4e-3, 1e-4, 2e-4, 5e-5, EXACT)
CONSTANTS = {"distance_scale": 0.03, "turn_scale": -0.02, "veer": 0.01}


def simulated_drive(seed: int, noise: MotionParameters = NOISE, steps: int = 4000) -> Drive:
    """Return a drive of 200 s at 0.5 m/s with turns on the way and in place, and odometry that errs as told."""
    rng = np.random.default_rng(seed)
    ahead = np.full(steps, 0.025)
    turn = 0.03 * np.sin(np.arange(steps) / 37.0)
    spot = (np.arange(steps) // 200) % 3 == 2
    ahead[spot], turn[spot] = 0.0, 0.04 * np.where((np.arange(steps) // 600) % 2, 1, -1)[spot]
    wheel_ahead, wheel_turn = ahead, turn
    path, turned = np.abs(wheel_ahead), np.abs(wheel_turn)
    true_ahead = (1 + CONSTANTS["distance_scale"]) * ahead
    true_ahead = true_ahead + np.sqrt(noise.alpha3 * path + noise.alpha4 * turned) * rng.normal(size=steps)
    true_turn = (1 + CONSTANTS["turn_scale"]) * turn + CONSTANTS["veer"] * ahead
    true_turn = true_turn + np.sqrt(noise.alpha1 * turned + noise.alpha2 * path) * rng.normal(size=steps)
    t_ns = np.arange(steps + 1) * 50_000_000
    tracks = []
    for way, angle in ((wheel_ahead, wheel_turn), (true_ahead, true_turn)):
        poses = np.zeros((steps + 1, 3))
        for k in range(steps):
            half = angle[k] / 2
            poses[k + 1] = compose(poses[k], [-way[k] * np.sin(half), -way[k] * np.cos(half), angle[k]])
        tracks.append(Trajectory(t_ns, poses))
    return Drive(f"drive {seed}", *tracks)


def test_noise_and_constants_are_found_within_their_sigmas():
    fit = fit_odometry([simulated_drive(0), simulated_drive(1), simulated_drive(2)], MotionParameters())
    true = np.array([getattr(NOISE, name) for name in ALPHAS])
    found = np.array([getattr(fit.motion, name) for name in ALPHAS])
    assert np.abs(np.log(found / true) / np.log(fit.factor)).max() < 3, (found, fit.factor)
    assert np.median(fit.factor) < 1.3
    constants = np.array(list(CONSTANTS.values()))
    assert np.abs((fit.constants - constants) / fit.sigmas).max() < 3.5
    np.testing.assert_allclose(fit.pieces.consistency(replace(fit.motion, bias=fit.before.bias))[1], 1.0, atol=0.4)


def test_sigmas_of_constant_errors_cover_those_of_the_drives():
    fit = fit_odometry([simulated_drive(0), simulated_drive(1)], MotionParameters())
    assert fit.motion.bias.distance_sigma == pytest.approx(np.sqrt((0.02**2 + 0.03**2) / 2), rel=0.1)
    assert fit.motion.bias.delay_sigma_s == fit.before.bias.delay_sigma_s, "and nothing else is changed"


def test_an_alpha_of_which_drives_tell_nothing_keeps_its_value():
    way = np.arange(2000.0)
    straight = Trajectory(np.arange(2000) * 50_000_000, np.stack([0 * way, -0.02 * way, 0 * way], axis=-1))
    fit = fit_odometry([Drive("straight", straight, straight)], MotionParameters())
    for name in ("alpha1", "alpha4"):
        assert getattr(fit.motion, name) == pytest.approx(getattr(fit.before, name), rel=0.01)
    assert fit.motion.alpha2 < 0.05 * fit.before.alpha2


def test_errors_of_the_path_are_not_taken_for_noise_of_the_wheels():
    exact = simulated_drive(3)
    rng = np.random.default_rng(0)
    every = slice(None, None, 10)
    poses = exact.truth.poses[every] + [0.02, 0.02, 0.02] * rng.normal(size=(401, 3))
    path = Trajectory(exact.truth.t_ns[every], poses)
    cov = np.tile(np.diag([4e-4, 4e-4, 4e-4]), (401, 1, 1))
    told = fit_odometry([Drive("told", exact.odometry, path, cov)], MotionParameters())
    untold = fit_odometry([Drive("untold", exact.odometry, path)], MotionParameters())
    true = fit_odometry([exact], MotionParameters())
    of_told, of_true, of_untold = (true.pieces.noise_var(fit.motion).mean(axis=0) for fit in (told, true, untold))
    assert (of_told < 1.5 * of_true).all() and (of_untold[0] > 1.5 * of_true[0])


def test_a_truth_by_another_clock_is_moved():
    right = simulated_drive(5)
    late = replace(right, truth=Trajectory(right.truth.t_ns + 310_000_000, right.truth.poses))
    moved, found = on_one_clock(late)
    assert found.offset_s == pytest.approx(0.31, abs=0.02)
    assert abs(int(moved.truth.t_ns[0]) - int(right.truth.t_ns[0])) < 20_000_000
    same, found = on_one_clock(right)
    assert same is right and abs(found.offset_s) < 0.02


def test_a_smoothed_path_is_nearer_to_the_truth_and_knows_it():
    whole = simulated_drive(6, MotionParameters(1e-3, 1e-3, 1e-3, 1e-4, EXACT))
    noise = MotionParameters(1e-3, 1e-3, 1e-3, 1e-4, EXACT)
    true, wheels = (track.poses[:2000:20] for track in (whole.truth, whole.odometry))
    rng = np.random.default_rng(1)
    covs, poses, increments = [np.diag([1e-4, 1e-4, 1e-4])], [true[0].copy()], []
    for k in range(1, len(true)):  # a filter: predicts by wheels, then measures the pose to 10 cm and 3°
        motion = between(wheels[k - 1], wheels[k])
        increments.append(Increment.from_mean(motion))
        by_pose, q = linearised(poses[-1], increments[-1], noise)
        predicted, cov = compose(poses[-1], motion), by_pose @ covs[-1] @ by_pose.T + q
        measured = true[k] + [0.1, 0.1, 0.05] * rng.normal(size=3)
        gain = cov @ np.linalg.inv(cov + np.diag([1e-2, 1e-2, 2.5e-3]))
        poses.append(predicted + gain @ (measured - predicted))
        covs.append((np.eye(3) - gain) @ cov)
    path, spread = smooth_path(np.array(poses), np.array(covs), increments, noise)
    before, after = (np.sqrt(((one - true)[:, :2] ** 2).sum(axis=1).mean()) for one in (np.array(poses), path))
    assert after < 0.85 * before
    assert (np.trace(spread, axis1=1, axis2=2) <= np.trace(np.array(covs), axis1=1, axis2=2) + 1e-12).all()
    np.testing.assert_array_equal(path[-1], poses[-1])
    off = (path - true)[10:-10]
    assert 1.0 < np.einsum("ti,tij,tj->t", off, np.linalg.inv(spread[10:-10]), off).mean() < 6.0


def test_pieces_end_where_poses_are_missing():
    whole = simulated_drive(4)
    kept = np.ones(4001, dtype=bool)
    kept[1000:1400] = False  # 20 s
    gappy = Drive("gap", Trajectory(whole.odometry.t_ns[kept], whole.odometry.poses[kept]), whole.truth)
    pieces = Pieces.of(gappy, 0)
    assert pieces.path_m.max() < 1.1 and pieces.turned_rad.max() < 1.1
    lost = Drive("gap", whole.odometry, Trajectory(whole.truth.t_ns[kept], whole.truth.poses[kept]))
    assert len(Pieces.of(lost, 0)) <= len(pieces) + 1
