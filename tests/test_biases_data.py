"""Constants of a real robot's wheels, found on the way, against least squares on motion capture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from localiser import geometry, mcl
from localiser.app.start import start_of
from localiser.config import load_config
from localiser.geometry import Array, Trajectory
from localiser.identified import observation_of
from localiser.storage import open_log

KNOWN = ["observation.association=known"]


def least_squares_factors(odometry: Trajectory, truth: Trajectory, from_ns: int, until_ns: int) -> tuple[float, float]:
    """True over commanded distance and turn, over pieces of 5 s; a veer is fitted beside the turn."""
    times = np.arange(from_ns, until_ns, 5_000_000_000)
    commanded, true = (
        geometry.between(track.sampled(times[:-1]).poses, track.sampled(times[1:]).poses) for track in (odometry, truth)
    )
    chord, true_chord = np.hypot(*commanded[:, :2].T), np.hypot(*true[:, :2].T)
    columns = np.stack([commanded[:, 2], chord], axis=1)
    turn = np.linalg.lstsq(columns, true[:, 2], rcond=None)[0][0]
    return float(chord @ true_chord / (chord @ chord)), float(turn)


@pytest.mark.data
def test_wheels_of_a_real_robot_are_learnt_and_it_is_located_within_its_sigmas(data_dir: Path) -> None:
    log = open_log(data_dir / "mrclam:2", format="mrclam")
    config = load_config(None, KNOWN, log.settings)
    assert log.groundtruth is not None and log.landmark_map is not None
    rng = np.random.default_rng(0)
    filter_ = mcl.Mcl(
        log.landmark_map,
        observation_of(log.camera, config.observation),
        config.mcl,
        config.motion,
        config.observation,
    )
    state = mcl.FilterState()
    found = [one for event in log.events(start_of(log, "truth", rng)) for one in mcl.step(filter_, state, event, rng)]
    truth = log.groundtruth.sampled([one.t_ns for one in found]).poses
    error: Array = np.array([one.estimate.pose for one in found]) - truth
    error[:, 2] = geometry.wrap_angle(error[:, 2])
    position_m = np.hypot(error[:, 0], error[:, 1])
    assert np.median(position_m) < 0.12
    assert np.sqrt(np.mean(position_m**2)) < 0.25

    last = found[-1].estimate
    value = dict(zip(last.names, last.mean, strict=True))
    distance, turn = least_squares_factors(log.odometry, log.groundtruth, found[0].t_ns, found[-1].t_ns)
    assert abs(turn - 1) > 0.05, "wheels that are right would show nothing"
    assert abs(1 + value["distance_scale"] - distance) < 0.05
    assert abs(1 + value["turn_scale"] - turn) < 0.05
