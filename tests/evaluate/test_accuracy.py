"""Errors against the truth: our figures, and evo's; the dictionary of figures."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, truncnorm

from localiser.commands.replay import _how_sure
from localiser.errors import InputError
from localiser.evaluate import Track, errors_against, metrics, nees, timing_metrics
from localiser.evaluate.accuracy import consistency_band, dead_reckoning, residual_sums
from localiser.evaluate.metrics import Pause, find_pauses
from localiser.geometry import Array, Trajectory, between, compose, wrap_angle
from localiser.observation import Matches
from localiser.replay import evaluate_run
from localiser.storage import write_tum

SECOND = 1_000_000_000


def random_trajectory(seed: int, count: int = 60) -> Trajectory:
    rng = np.random.default_rng(seed)
    poses = np.cumsum(rng.normal(size=(count, 3)) * [0.2, 0.2, 0.5], axis=0)
    poses[:, 2] = wrap_angle(poses[:, 2])
    return Trajectory(np.cumsum(rng.integers(SECOND // 20, SECOND, count)), poses)


def disturbed(trajectory: Trajectory, seed: int, sigma: tuple[float, float, float] = (0.1, 0.2, 0.3)) -> Array:
    poses = trajectory.poses + np.random.default_rng(seed).normal(size=trajectory.poses.shape) * sigma
    poses[:, 2] = wrap_angle(poses[:, 2])
    return poses


@pytest.mark.parametrize("seed", range(4))
def test_figures_are_those_of_evo(seed: int, tmp_path: Path) -> None:
    from evo.core import metrics as evo_metrics
    from evo.core import sync
    from evo.tools import file_interface

    truth = random_trajectory(seed)
    track = Track.from_poses(truth.t_ns, disturbed(truth, seed + 100))
    write_tum(truth, tmp_path / "truth.tum")
    write_tum(Trajectory(track.t_ns, track.poses), tmp_path / "run.tum")
    pair = sync.associate_trajectories(
        file_interface.read_tum_trajectory_file(tmp_path / "truth.tum"),
        file_interface.read_tum_trajectory_file(tmp_path / "run.tum"),
    )

    def evo(relation: evo_metrics.PoseRelation) -> dict[str, float]:
        ape = evo_metrics.APE(relation)
        ape.process_data(pair)
        return ape.get_all_statistics()

    ours = metrics(track, truth, log="random")
    position, heading = evo(evo_metrics.PoseRelation.translation_part), evo(evo_metrics.PoseRelation.rotation_angle_deg)
    assert ours["position_rmse_m"] == pytest.approx(position["rmse"], abs=1e-6)
    assert ours["position_median_m"] == pytest.approx(position["median"], abs=1e-6)
    assert ours["position_max_m"] == pytest.approx(position["max"], abs=1e-6)
    assert ours["heading_rmse_deg"] == pytest.approx(heading["rmse"], abs=1e-5)


def test_error_of_known_offsets() -> None:
    truth = Trajectory(np.array([0, 1, 2]) * SECOND, np.array([[0.0, 0, 3.1], [1, 0, 3.1], [2, 0, 3.1]]))
    offset = np.array([[0.3, 0.4, 0.1], [0, 0, 0], [0, -2, -0.2]])
    track = Track.from_poses(truth.t_ns, truth.poses + offset)
    errors = errors_against(track, truth)
    np.testing.assert_allclose(errors.position_m, [0.5, 0, 2], atol=1e-12)
    np.testing.assert_allclose(errors.heading_rad, [0.1, 0, -0.2], atol=1e-12)
    figures = metrics(track, truth, log="three")
    assert figures["position_rmse_m"] == pytest.approx(np.sqrt(4.25 / 3), abs=1e-6)
    assert (figures["position_median_m"], figures["position_max_m"], figures["position_end_m"]) == (0.5, 2.0, 2.0)
    assert figures["heading_rmse_deg"] == pytest.approx(np.degrees(np.sqrt(0.05 / 3)), abs=1e-6)


def test_truth_is_interpolated_along_the_arc() -> None:
    """A quarter circle of radius 1 between two true poses: the robot is on the arc, not on its chord."""
    start = np.array([0.0, 0.0, 0.0])
    quarter_left = np.array([-1.0, -1.0, np.pi / 2])
    truth = Trajectory(np.array([0, 2 * SECOND]), np.stack([start, compose(start, quarter_left)]))
    middle = [np.sqrt(0.5) - 1, -np.sqrt(0.5), np.pi / 4]
    errors = errors_against(Track.from_poses([SECOND], [middle]), truth)
    np.testing.assert_allclose(errors.truth, [middle], atol=1e-12)
    assert errors.position_m[0] < 1e-12


@settings(max_examples=30)
@given(st.integers(0, 1000), st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3, 3)))
def test_odometry_counts_by_its_increments_alone(seed: int, frame: tuple[float, float, float]) -> None:
    """The odometry's own frame may lie anywhere: what counts is the motion, set on at the first true pose."""
    truth = random_trajectory(seed, 20)
    elsewhere = compose(np.array(frame), between(truth.poses[0], truth.poses))
    np.testing.assert_allclose(dead_reckoning(elsewhere, truth.poses[0])[:, :2], truth.poses[:, :2], atol=1e-9)
    errors = errors_against(Track.from_poses(truth.t_ns, truth.poses, odometry=elsewhere), truth)
    np.testing.assert_allclose(errors.odometry_m, 0, atol=1e-9)


def test_images_outside_the_truth_are_left_out() -> None:
    truth = Trajectory(np.array([1, 2]) * SECOND, np.zeros((2, 3)))
    track = Track.from_poses(np.array([0, 1, 2, 3]) * SECOND, [[9.0, 0, 0], [1, 0, 0], [1, 0, 0], [9, 0, 0]])
    errors = errors_against(track, truth)
    np.testing.assert_array_equal(np.isnan(errors.position_m), [True, False, False, True])
    figures = metrics(track, truth, log="part")
    assert (figures["frames"], figures["position_max_m"], figures["position_end_m"]) == (4, 1.0, 1.0)


def test_truth_of_another_time_is_an_error_that_says_so() -> None:
    truth = Trajectory(np.array([100, 200]) * SECOND, np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"groundtruth: .*0\.000 s to 1\.000 s.*100\.000 s to 200\.000 s"):
        errors_against(Track.from_poses([0, SECOND], np.zeros((2, 3))), truth)


@pytest.mark.parametrize("how", ["origin", "se2"])
def test_truth_of_another_frame_is_aligned_on_request(how: str) -> None:
    rng, times = np.random.default_rng(4), np.arange(40) * SECOND
    poses = np.cumsum(rng.normal(0.2, 0.3, (40, 3)), axis=0)
    truth = Trajectory(times, compose(np.array([500.0, -300.0, 2.0]), poses))
    assert evaluate_run(Track.from_poses(times, poses), truth)["position_rmse_m"] > 100
    figures = evaluate_run(Track.from_poses(times, poses), truth, how)
    assert figures["position_rmse_m"] < 1e-9 and figures["heading_rmse_deg"] < 1e-9
    noisy = evaluate_run(Track.from_poses(times, poses + rng.normal(0, 0.05, (40, 3)) * [1, 1, 0]), truth, "se2")
    assert 0.05 < noisy["position_rmse_m"] < 0.09
    with pytest.raises(InputError, match="--align: expected origin or se2, found 'sim3'"):
        evaluate_run(Track.from_poses(times, poses), truth, "sim3")


# -- consistency ------------------------------------------------------------------------------------------------------

COV = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.004], [0.002, -0.004, 0.01]])


def test_nees_is_the_quadratic_form_and_unknown_for_singular_covariances() -> None:
    error = np.random.default_rng(0).normal(size=(50, 3))
    expected = [e @ np.linalg.inv(COV) @ e for e in error]
    np.testing.assert_allclose(nees(error, np.tile(COV, (50, 1, 1))), expected, rtol=1e-10)
    covs = np.stack([COV, np.zeros((3, 3)), np.diag([1.0, 1.0, 0.0]), np.full((3, 3), np.nan), COV])
    errors = np.ones((5, 3))
    errors[4] = np.nan
    np.testing.assert_array_equal(np.isfinite(nees(errors, covs)), [True, False, False, False, False])


def matches_of(residual: Array, sigma: Array, gate: float) -> Matches:
    return replace(Matches.none(len(residual), 0), residual=residual, sigma=sigma, gate=np.full(len(residual), gate))


@pytest.mark.parametrize("gate", [0.7, 2.0, 4.0])
def test_moments_of_residuals_are_those_of_a_normal_variable_that_is_cut_off(gate: float) -> None:
    cut = truncnorm(-gate, gate)
    square, fourth = cut.moment(2), cut.moment(4)
    found = residual_sums(matches_of(np.array([0.02]), np.array([0.01]), gate))
    np.testing.assert_allclose(found, [4.0, square, fourth - square**2], rtol=1e-9)


def test_band_of_residuals_is_that_of_chi_squared_and_nothing_matched_is_unknown() -> None:
    sums = np.array([residual_sums(matches_of(np.zeros(7), np.ones(7), np.inf))])
    low, high = consistency_band(sums)
    np.testing.assert_allclose([low[0], high[0]], chi2(7).ppf([0.025, 0.975]) / 7)
    clutter = np.array([np.nan, np.nan])
    assert np.isnan(residual_sums(matches_of(clutter, clutter, np.nan))).all()
    assert np.isnan(residual_sums(replace(Matches.none(2, 0), residual=np.zeros(2)))).all()


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


@pytest.mark.parametrize(
    ("images_s", "sighted_s", "pauses_s"),
    [
        (range(20), [*range(5), *range(7, 20)], []),  # 3 s from sighting to sighting: not longer than 3 s
        (range(20), [*range(5), *range(8, 20)], [(4, 8)]),
        (range(20), [4, *range(8, 20)], [(0, 4), (4, 8)]),  # begins blind
        (range(20), [4, *range(8, 12)], [(0, 4), (4, 8)]),  # ends blind: nothing comes after
        (range(20), [], []),
        ([0, 1, 9, 10], [0, 1, 9, 10], [(1, 9)]),  # a log that holds a frame only when something was seen
    ],
)
def test_pauses_are_found_by_their_length(images_s, sighted_s, pauses_s):
    expected = tuple(Pause(begin * SECOND, end * SECOND) for begin, end in pauses_s)
    assert find_pauses(np.array(images_s) * SECOND, np.isin(images_s, sighted_s)) == expected


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
    assert _how_sure(found | {"reasons": {"no edges": 1, "lost": 2}}).endswith("no edges (1 image), lost (2 images).")


def test_a_base_that_restarts_drives_no_farther() -> None:
    t_ns = np.arange(20) * SECOND // 2
    along = np.column_stack([np.zeros(20), -0.3 * np.arange(20), np.zeros(20)])
    restarted = np.concatenate([along[:12] + np.array([6.0, 0.0, 0.0]), along[12:] - along[12]])
    figures = [
        metrics(Track.from_poses(t_ns, along, odometry=odometry), Trajectory(t_ns, along), log="restart")
        for odometry in (along, restarted)
    ]
    assert figures[0]["distance_m"] == pytest.approx(19 * 0.3) == figures[1]["distance_m"]
