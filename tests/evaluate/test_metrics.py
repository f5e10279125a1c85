"""The dictionary of figures, and what it says about pauses."""

from __future__ import annotations

import json

import numpy as np
import pytest

from localiser.evaluate import Track, metrics, timing_metrics
from localiser.evaluate.metrics import Pause, find_pauses
from localiser.geometry import Trajectory

SECOND = 1_000_000_000
KEYS = [
    "log", "observation", "association", "odometry", "start", "map", "inputs", "particles", "seed", "frames",
    "position_rmse_m", "position_median_m", "position_max_m", "position_end_m", "heading_rmse_deg",
    "odometry_position_rmse_m", "nees_mean", "edges_per_frame",
    "frame_ms_median", "frame_ms_p95", "stage_ms",
]  # fmt: skip


def run_with_a_pause() -> tuple[Track, Trajectory]:
    """40 images at 1 Hz; no edges from 10 s to 17 s, during which the error grows by 0.2 m a second.

    It stays 1.4 m until 20 s, three seconds after the first edges, and is 0.1 m otherwise.
    """
    seconds = np.arange(40)
    edges = np.where((seconds >= 10) & (seconds < 17), 0, 5)
    error = np.full(40, 0.1)
    error[10:17] = 0.2 * np.arange(1, 8)
    error[17:20] = 1.4
    poses = np.stack([error, np.zeros(40), np.zeros(40)], axis=-1)
    covs = np.tile(np.diag([0.01, 0.01, 0.01]), (40, 1, 1))
    track = Track.from_poses(seconds * SECOND, poses, covs=covs, odometry=poses, edges=edges)
    return track, Trajectory(seconds * SECOND, np.zeros((40, 3)))


def test_every_key_of_the_format_is_there_and_survives_json() -> None:
    track, truth = run_with_a_pause()
    figures = metrics(track, truth, log="l", about={"observation": "line", "seed": 3, "particles": 500})
    figures |= timing_metrics(
        {"load": [1.0, 2, 3], "edges": [10.0, 10, 40], "filter": [5.0, 5, 5], "sinks": [0.0, 0, 1]}
    )
    assert [key for key in figures if key in KEYS] == KEYS
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures
    assert figures["nees_mean"] == pytest.approx(100 * figures["position_rmse_m"] ** 2, abs=1e-3)
    assert figures["edges_per_frame"] == 33 * 5 / 40
    assert (figures["frame_ms_median"], figures["stage_ms"]["load"]) == (17.0, 2.0)


def test_a_bare_trajectory_has_errors_but_no_nees_nor_edges() -> None:
    truth = Trajectory(np.arange(3) * SECOND, np.zeros((3, 3)))
    figures = metrics(Track.from_poses(truth.t_ns, [[1.0, 0, 0]] * 3), truth, log="tum")
    assert figures["position_rmse_m"] == 1.0
    assert figures["nees_mean"] is None
    assert figures["edges_per_frame"] is None
    assert figures["odometry_position_rmse_m"] is None
    assert figures["pauses"] == [] and figures["confidence"]["sure"] is None


def test_a_pause_is_told_with_when_and_how_long() -> None:
    track, _ = run_with_a_pause()
    assert metrics(track, None, log="l")["pauses"] == [{"start_s": 9.0, "duration_s": 8.0}]


def test_pauses_are_found_by_their_length() -> None:
    t_ns = np.arange(20) * SECOND
    sighted = np.ones(20, dtype=bool)
    sighted[[5, 6]] = False  # 3 s from sighting to sighting: not longer than 3 s
    assert find_pauses(t_ns, sighted) == ()
    sighted[7] = False
    assert find_pauses(t_ns, sighted) == (Pause(4 * SECOND, 8 * SECOND),)
    sighted[:4] = False  # begins blind
    assert find_pauses(t_ns, sighted) == (Pause(0, 4 * SECOND), Pause(4 * SECOND, 8 * SECOND))
    sighted[12:] = False  # ends blind: nothing comes after
    assert len(find_pauses(t_ns, sighted)) == 2
    assert find_pauses(t_ns, np.zeros(20, dtype=bool)) == ()


def test_a_pause_between_images_counts_too() -> None:
    """Logs that hold a frame only when something was seen: the gap lies between two frames."""
    t_ns = np.array([0, 1, 9, 10]) * SECOND
    everything = np.ones(4, dtype=bool)
    assert find_pauses(t_ns, everything) == (Pause(SECOND, 9 * SECOND),)


def test_how_sure_a_run_was_and_how_rightly() -> None:
    """Five images: not found yet, sure, wrong by position, wrong by heading though sure, lost though right."""
    t_ns = np.arange(5) * SECOND
    poses = np.array([[3.0, 0, 0], [0.1, 0, 0], [0.6, 0, 0], [0, 0, 0.3], [0, 0.2, 0]])
    track = Track.from_poses(t_ns, poses, p_correct=[0.1, 0.95, 0.91, 0.99, 0.4], found=[0, 1, 1, 1, 0])
    reasons = ["several places fit", "", "", "", "no edges"]
    figures = metrics(track, Trajectory(t_ns, np.zeros((5, 3))), log="five", reasons=reasons)
    found = figures["confidence"]
    assert found["sure"] == 0.6
    assert (found["correct"], found["sure_and_wrong"]) == pytest.approx((1 / 2, 1 / 2), abs=1e-6)
    assert found["found_s"] == 1.0 and found["not_found"] == 0.2
    assert figures["position_rmse_m"] == pytest.approx(np.sqrt((0.01 + 0.36 + 0 + 0.04) / 4), abs=1e-6)
    assert figures["position_max_m"] == 0.6 and figures["position_end_m"] == 0.2
    assert found["reasons"] == {"no edges": 1, "several places fit": 1}


def test_a_base_that_restarts_drives_no_farther() -> None:
    t_ns = np.arange(20) * SECOND // 2
    along = np.column_stack([np.zeros(20), -0.3 * np.arange(20), np.zeros(20)])
    restarted = np.concatenate([along[:12] + np.array([6.0, 0.0, 0.0]), along[12:] - along[12]])
    figures = [
        metrics(Track.from_poses(t_ns, along, odometry=odometry), Trajectory(t_ns, along), log="restart")
        for odometry in (along, restarted)
    ]
    assert figures[0]["distance_m"] == pytest.approx(19 * 0.3) == figures[1]["distance_m"]
