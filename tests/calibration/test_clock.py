"""The offset between the clocks of images and wheels, from the turns that both show."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from folders import ROOT

from localiser.calibration import ClockOffset, clock_offset
from localiser.calibration.clock import REACH_S, offset_of_turns
from localiser.edges import Edges, find_edges
from localiser.geometry import Trajectory
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
