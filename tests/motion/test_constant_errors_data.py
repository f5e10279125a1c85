"""Constants of a real robot's wheels, found on the way, against least squares on motion capture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mrclam import MrclamReader
from numpy.typing import NDArray

from localiser import geometry
from localiser.calibration import SCALES, Drive, fit_odometry
from localiser.config import read_config
from localiser.filter import mcl
from localiser.geometry import Array, Trajectory
from localiser.observation import EdgeObservation
from localiser.replay.run import start_of
from localiser.storage.log import ReadOptions

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
    assert log.groundtruth is not None and log.landmark_map is not None
    rng = np.random.default_rng(0)
    filter_ = mcl.Mcl(
        log.landmark_map,
        EdgeObservation(log.camera, config.observation),
        config.mcl,
        config.motion,
        config.observation,
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
    assert fit is not None
    estimate, by_truth = found[-1].estimate, dict(zip(SCALES, fit.constants[0], strict=True))
    learnt = dict(zip(estimate.names, estimate.mean, strict=True))
    assert abs(by_truth["turn_scale"]) > 0.03, "wheels that are right would show nothing"
    assert abs(learnt["turn_scale"] - by_truth["turn_scale"]) < 0.05
    assert abs(learnt["distance_scale"] - by_truth["distance_scale"]) < 0.05
    assert abs(learnt["delay"] - likeliest_delay(log.odometry, log.groundtruth, *between)) < 0.08
    delay = estimate.names.index("delay")
    assert estimate.cov[delay, delay] < 0.08**2
