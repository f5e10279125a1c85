"""Which landmarks may be one, and which joins were wrong: by the pull of a visit, and by the wheels."""

from dataclasses import replace

import numpy as np
import pytest
from ring_world import circle

from localiser.geometry import Array
from localiser.mapping import Prior
from localiser.mapping.factors import Bearings, Problem, Steps
from localiser.mapping.loop_closure import (
    compatible,
    contradicting_steps,
    contradiction,
    visit_contradiction,
    visits,
    without_contradicting_visits,
)
from localiser.mapping.sightings import Index
from localiser.mapping.smooth import Smoothed, dead_reckoning, smooth

FRAMES = 150


def solved(problem: Problem, points: Array) -> Smoothed:
    return smooth(problem, dead_reckoning(problem.wheels), points, np.zeros(4), iterations=60)


def two_laps(seed: int) -> tuple[Problem, Array, Index]:
    """Return two laps round a ring of landmarks, the landmarks' places, and the visit of each bearing."""
    problem, _, points = circle(1.0, seed=seed, frames=FRAMES, laps=2)
    return problem, points, visits(problem.bearings.landmark, problem.bearings.frame)


def test_a_visit_ends_with_a_long_pause() -> None:
    landmark = np.array([0, 1, 0, 0, 1, 0])
    frame = np.array([0, 0, 30, 61, 61, 62])
    assert visits(landmark, frame).tolist() == [0, 2, 0, 1, 3, 1]
    assert visits(landmark[:0], frame[:0]).tolist() == []


@pytest.mark.parametrize("seed", range(3))
def test_right_joins_do_not_contradict(seed: int) -> None:
    problem, points, visit = two_laps(seed)
    found = visit_contradiction(problem, solved(problem, points), visit, np.arange(visit.max() + 1))
    # Squared sigmas of two coordinates: their median is 1.4 where errors are as stated, less with joins too close.
    assert np.median(found) < 2.0
    assert np.quantile(found, 0.97) < 11.8


@pytest.mark.parametrize("seed", range(3))
def test_score_is_what_solving_anew_finds(seed: int) -> None:
    problem, points, visit = two_laps(seed)
    bearings = problem.bearings
    several = np.flatnonzero(np.bincount(visit) > 20)
    asked = several[np.bincount(visit)[several].argsort()[-2:]]
    together = solved(problem, points)
    found = visit_contradiction(problem, together, visit, asked)
    for index, one in enumerate(asked):
        own = np.where(visit == one, len(points), bearings.landmark)
        apart = replace(problem, bearings=replace(bearings, landmark=own))
        place = points[bearings.landmark[visit == one][:1]]
        fell = together.cost - solved(apart, np.concatenate([points, place])).cost
        assert found[index] <= fell + 0.5  # two visits may stand 4 mm apart, which the solution does not know
        assert found[index] == pytest.approx(fell, abs=0.5 + 0.5 * fell)


@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_join_is_opened(seed: int) -> None:
    problem, points, _ = two_laps(seed)
    bearings = problem.bearings
    second = bearings.frame > FRAMES // 2
    both = [x for x in range(len(points)) if np.bincount(second[bearings.landmark == x], minlength=2).min() > 8]
    near = np.linalg.norm(points[both][:, None] - points[both][None], axis=-1) + 9 * np.eye(len(both))
    one, other = np.array(both)[list(np.unravel_index(near.argmin(), near.shape))]
    # On the second lap one landmark is taken for its neighbour, which is not seen then.
    kept = ~(second & (bearings.landmark == other))
    names = [bearings.frame, bearings.landmark, bearings.bearing, bearings.sigma]
    frame, landmark, bearing, sigma = (column[kept] for column in names)
    wrong = np.where((landmark == one) & second[kept], other, landmark)
    mixed = replace(problem, bearings=Bearings(frame, wrong, bearing, sigma))
    of = without_contradicting_visits(mixed, solved(mixed, points), wrong, np.arange(len(wrong)))
    left = of != wrong
    assert left[wrong == other].any()
    assert (wrong[left] == other).all()


# -- joint compatibility ----------------------------------------------------------------------------------------------

_NOISE_M, _OWN_SIGMA_M, _DRIFT_SIGMA_M = 0.004, 0.01, 0.2


def of_one_drift(difference: Array) -> Array:
    """Return the covariance (2 P, 2 P) of differences (P, 2) that share a drift and have small errors of their own."""
    count = len(difference)
    shared = np.kron(np.ones((count, count)), _DRIFT_SIGMA_M**2 * np.eye(2))
    return np.asarray(shared + _OWN_SIGMA_M**2 * np.eye(2 * count))


def test_pairs_that_agree_on_one_drift_are_chosen_and_others_are_not() -> None:
    difference = np.array([[0.2, 0.0], [0.21, 0.01], [0.19, 0.0], [0.2, -0.01], [0.0, 0.0]])
    chosen = compatible(difference, of_one_drift(difference), _NOISE_M)
    assert chosen.tolist() == [True, True, True, True, False]


def test_two_drifts_that_explain_as_many_pairs_are_not_decided() -> None:
    """Book spines at equal distances fit one step on as well; a smaller drift is no reason to choose it."""
    difference = np.array([[0.2, 0.0], [0.21, 0.0], [0.19, 0.0], [0.0, 0.0], [0.01, 0.0], [0.0, 0.01]])
    assert not compatible(difference, of_one_drift(difference), _NOISE_M).any()


def test_pairs_that_share_no_drift_do_not_decide_on_each_other() -> None:
    difference = np.array([[0.2, 0.0], [-0.2, 0.0]])
    cov = (_DRIFT_SIGMA_M**2 + _OWN_SIGMA_M**2) * np.eye(4)
    assert compatible(difference, cov, _NOISE_M).all()


# -- the wheels -------------------------------------------------------------------------------------------------------

PRIOR = Prior(np.zeros(4), np.array([0.02, 0.03, 0.01, 0.02]))
SIGMA = np.array([0.01, 0.01, 0.003])


def driven(seed: int, steps: int = 200) -> tuple[Steps, Array]:
    """Return what wheels say of a drive along a curve, and where the robot was."""
    motion = np.tile([0.0, -0.1, 0.02], (steps, 1))
    cov = np.tile(np.diag(SIGMA**2), (steps, 1, 1))
    exact = Steps(motion, np.full(steps, 0.1), cov)
    noise = SIGMA * np.random.default_rng(seed).standard_normal((steps, 3))
    return Steps(motion + noise, exact.path_m, cov), dead_reckoning(exact)


@pytest.mark.parametrize("steps", [200, 20000])
@pytest.mark.parametrize("seed", range(4))
def test_the_true_path_agrees(seed: int, steps: int) -> None:
    wheels, poses = driven(seed, steps)
    assert contradiction(wheels, PRIOR, poses, np.zeros(4)) is None
    assert len(contradicting_steps(wheels, poses, np.zeros(4))) == 0


def test_a_path_that_a_wrong_loop_bent_contradicts_the_noise() -> None:
    wheels, poses = driven(0)
    bent = poses.copy()
    bent[:, 0] += 0.8 * np.clip((np.arange(len(poses)) - 90) / 20, 0, 1)  # 0.8 m to the side within two metres
    assert "from image" in str(contradiction(wheels, PRIOR, bent, np.zeros(4)))


@pytest.mark.parametrize("seed", range(2))
def test_steps_that_the_wheels_did_not_make_are_named(seed: int) -> None:
    wheels, poses = driven(seed)
    assert len(contradicting_steps(wheels, poses, np.zeros(4))) == 0
    poses[43:, 0] += 0.1
    poses[120:, 1] -= 0.1
    assert contradicting_steps(wheels, poses, np.zeros(4)).tolist() == [42, 119]


def test_a_scale_that_wheels_cannot_have_is_named() -> None:
    wheels, poses = driven(0)
    found = contradiction(wheels, PRIOR, poses, np.array([0.1, 0.0, 0.0, 0.0]))
    assert "5.0 sigmas off (distance scale)" in str(found)
