"""A run without truth tells the same of itself as one with it, and the truth agrees with what it tells."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from short_log import CORRIDOR

from localiser import open_log, replay_log
from localiser.evaluate.metrics import own_figures
from localiser.replay import Replay
from localiser.storage import Log

ERRORS = {
    "position_rmse_m", "position_median_m", "position_max_m", "position_end_m", "heading_rmse_deg",
    "odometry_position_rmse_m", "nees_mean",
}  # fmt: skip


pytestmark = pytest.mark.slow  # two replays of half a log


def half_of_corridor() -> Log:
    log = open_log(CORRIDOR)
    return replace(log, frames=log.frames[: len(log.frames) // 2])


@pytest.fixture(scope="module")
def run() -> Replay:
    """The shipped log, as its user has it who knows no truth."""
    return replay_log(replace(half_of_corridor(), groundtruth=None), seed=0)


@pytest.fixture(scope="module")
def known() -> Replay:
    return replay_log(half_of_corridor(), seed=0)


@pytest.fixture(scope="module")
def figures(run: Replay) -> dict[str, Any]:
    return run.metrics


def test_it_tells_the_same_of_itself_and_nothing_of_errors(run: Replay, known: Replay, figures: dict[str, Any]) -> None:
    with_truth = known.metrics
    own = own_figures(run.track)
    assert all(figures[key] is not None for key in own)
    assert {key: figures[key] for key in own} == {key: with_truth[key] for key in own}
    assert {key for key in figures if figures[key] is None and with_truth[key] is not None} == ERRORS
    for key in ("sure", "found_s", "reasons"):
        assert figures["confidence"][key] == with_truth["confidence"][key]
    assert figures["warnings"] == with_truth["warnings"]


def test_errors_are_as_large_as_it_expects(known: Replay, figures: dict[str, Any]) -> None:
    truth = known.log.groundtruth
    error = known.track.poses - truth.sampled(known.track.t_ns).poses
    distance_m, turn_deg = np.hypot(*error[:, :2].T), np.degrees(np.abs(error[:, 2]))
    assert (distance_m < 3 * known.track.position_sigma_m).mean() > 0.99
    assert 0.3 * distance_m.max() < figures["position_3sigma_median_m"] <= figures["position_3sigma_max_m"]
    assert np.median(turn_deg) < figures["heading_3sigma_median_deg"] <= figures["heading_3sigma_max_deg"]
    assert figures["position_3sigma_max_m"] == pytest.approx(3 * known.track.position_sigma_m.max(), abs=1e-6)


def test_distance_and_speed_are_the_true_ones(known: Replay, figures: dict[str, Any]) -> None:
    truth, times = known.log.groundtruth, known.track.t_ns
    driven_m = np.hypot(*np.diff(truth.sampled(times).poses[:, :2], axis=0).T).sum()
    wheels_m = np.hypot(*np.diff(known.track.odometry[:, :2], axis=0).T).sum()
    assert figures["distance_m"] == pytest.approx(driven_m, rel=0.01)
    assert abs(wheels_m - driven_m) > abs(figures["distance_m"] - driven_m), "the learnt scale helps"
    assert figures["duration_s"] == pytest.approx((times[-1] - times[0]) / 1e9)
    assert figures["speed_mean_m_s"] == pytest.approx(driven_m / figures["duration_s"], rel=0.01)
