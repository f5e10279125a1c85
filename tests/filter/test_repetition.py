"""Which share of errors of edges repeats is learnt from residuals, and makes images of a good map count for more."""

from __future__ import annotations

from collections.abc import Callable

import efficiency
import numpy as np
import pytest
from board.run import Drive, run
from simulated_edges import simulated_edges

from localiser import Localiser, read_config
from localiser.filter.repetition import LEAST_SHARE, Repetition
from localiser.geometry import Array, Increment, between
from localiser.observation import Matches, ObservationParameters, correlation_of, novelty_of

LANDMARKS = 12


def matched(z: Array) -> Matches:
    """Return matches of an image whose edges show landmarks 0, 1, … with these standardised residuals (L,)."""
    sigma = np.full(len(z), 0.002)
    return Matches(np.arange(len(z)), z * sigma, np.ones(len(z), dtype=bool), sigma)


def residuals(images: int, share: float, correlation: float, rng: np.random.Generator) -> Array:
    """Return standardised residuals (images, L) a share of whose variance is a first-order Markov process."""
    repeats = rng.standard_normal(LANDMARKS)
    every = []
    for _ in range(images):
        repeats = correlation * repeats + np.sqrt(1 - correlation**2) * rng.standard_normal(LANDMARKS)
        every.append(np.sqrt(share) * repeats + np.sqrt(1 - share) * rng.standard_normal(LANDMARKS))
    return 0.7 * np.array(every)  # sigmas are too large, as they may be


def learnt(every: Array, correlation: float) -> Repetition:
    known = Repetition()
    for one in every:
        known = known.after(matched(one), correlation)
    return known


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("correlation", [0.4, 0.8])
def test_the_share_that_repeats_is_found(share: float, correlation: float) -> None:
    rng = np.random.default_rng([11, int(10 * share), int(10 * correlation)])
    found = [learnt(residuals(1000, share, correlation, rng), correlation).share for _ in range(20)]
    # Cut off at 1, so that the mean is below 1 where all repeats.
    assert np.mean(found) == pytest.approx(share, abs=0.06)


def test_errors_are_taken_as_repeating_until_images_say_otherwise() -> None:
    assert Repetition().share == 1.0
    fresh = np.random.default_rng(2).standard_normal((400, LANDMARKS))
    assert learnt(fresh[:5], 0.5).share > 0.7
    assert learnt(fresh, 0.5).share == LEAST_SHARE


def test_images_from_one_place_are_not_compared() -> None:
    assert learnt(np.random.default_rng(3).standard_normal((400, LANDMARKS)), 0.999).pairs == 0


def test_images_before_and_after_an_unknown_motion_are_not_compared() -> None:
    z = np.random.default_rng(4).standard_normal((2, LANDMARKS))
    before = Repetition().after(matched(z[0]), 0.3)
    assert before.after(matched(z[1]), 0.3).pairs == LANDMARKS
    assert before.interrupted().after(matched(z[1]), 0.3).pairs == 0


def test_few_or_far_edges_tell_nothing() -> None:
    far = np.where(np.arange(LANDMARKS) < 3, 0.5, 8.0)
    assert Repetition().after(matched(far), 0.3).after(matched(far), 0.3).pairs == 0


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_an_image_counts_for_what_the_mean_of_many_is_worth(share: float) -> None:
    """Against the variance of the mean of many images, from their whole covariance matrix."""
    parameters, moved = ObservationParameters(), Increment.from_mean([0.0, -0.08, 0.02])
    correlation, images = correlation_of(moved, parameters), 2000
    apart = np.abs(np.subtract.outer(np.arange(images), np.arange(images)))
    cov = share * correlation**apart + (1 - share) * np.eye(images)
    assert novelty_of(moved, parameters, repeated=share) == pytest.approx(1 / (images * cov.mean()), rel=0.01)


@pytest.fixture(scope="module")
def on_an_exact_map() -> list[Drive]:
    """Return drives whose edges err independently in each image, on a map without errors."""
    setting = efficiency.setting_of("corridor", 150)
    moves = [Increment.from_mean(m) for m in between(setting.odometry.poses[:-1], setting.odometry.poses[1:])]
    drives = []
    for seed in range(2):
        rng = np.random.default_rng([21, seed])
        truth = efficiency.strayed(setting.odometry, moves, rng)
        edges = simulated_edges(setting.landmark_map, setting.camera, truth, rng, visible=setting.visible)
        drives.append(
            Drive("exact", setting.landmark_map, setting.camera, setting.odometry, truth.t_ns, edges, truth.poses)
        )
    return drives


@pytest.mark.parametrize("unknown", [Localiser.forget_wheels, Localiser.look_everywhere])
def test_after_an_unknown_motion_no_earlier_image_is_compared(
    unknown: Callable[[Localiser, int], object], on_an_exact_map: list[Drive]
) -> None:
    drive = on_an_exact_map[0]
    robot = Localiser(drive.landmark_map, drive.camera, read_config(), 0)
    robot.start(drive.truth[0], np.diag([0.1, 0.1, 0.05]) ** 2, int(drive.t_ns[0]))

    def see(image: int) -> None:
        robot.odometry(int(drive.t_ns[image]), drive.odometry.poses[image])
        robot.edges(int(drive.t_ns[image]), drive.edges[image])

    for image in range(40):
        see(image)
    assert robot.state.repetition.last is not None
    unknown(robot, int(drive.t_ns[40]) - 1)
    see(40)
    assert robot.state.repetition.last is None


@pytest.mark.parametrize("kind", ["line", pytest.param("slope", marks=pytest.mark.slow)])
def test_on_an_exact_map_images_count_for_more_and_the_pose_is_better(
    kind: str, on_an_exact_map: list[Drive], monkeypatch: pytest.MonkeyPatch
) -> None:
    def rmse_m(drive: Drive) -> float:
        return float(np.sqrt(np.mean(run(drive, 0, observation=kind).error_m[50:] ** 2)))

    learnt_m = [rmse_m(drive) for drive in on_an_exact_map]
    monkeypatch.setattr(Repetition, "share", 1.0)
    repeated_m = [rmse_m(drive) for drive in on_an_exact_map]
    ratio = np.divide(learnt_m, repeated_m)
    assert ratio.max() < 1.0
    assert ratio.mean() < 0.95
