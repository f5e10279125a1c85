"""A robot whose place is not known, or is known wrongly: the odds of being lost, the search, and what is said of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from proposal_room import CAMERA, room

from localiser import geometry
from localiser.filter import FilterState, Located, Mcl, MclParameters, Odometry, Sighting, Start, step
from localiser.filter.alternative_hypothesis import AlternativeHypothesis
from localiser.filter.confidence import confidence_of, is_near
from localiser.geometry import Array, Trajectory
from localiser.observation import INLIER_RATES, EdgeObservation, ObservationParameters
from localiser.particles import CAMERA_YAW, POSE, Clusters, Particles, find_clusters
from localiser.relocalisation import global_localisation as search
from localiser.relocalisation.global_localisation import GlobalLocalisation, SearchParameters
from localiser.relocalisation.lost_probability import OVERLOOKED, LostProbability
from localiser.simulate import EdgeNoise, simulated_edges

SECOND = 1_000_000_000
ROOM = room(80)
CORRELATION = ObservationParameters()
OBSERVATION = EdgeObservation(CAMERA, CORRELATION)
SEARCH = GlobalLocalisation.of(OBSERVATION, ROOM, SearchParameters(particles_most=3000))
FILTER = Mcl(ROOM, OBSERVATION, MclParameters(particles=500, start_particles=2000), search=SEARCH)


def cloud(poses: Array, log_weight: Array | None = None) -> Particles:
    return Particles(
        POSE, np.asarray(poses, dtype=float).T.copy(), np.zeros(len(poses)) if log_weight is None else log_weight
    )


@dataclass(frozen=True)
class Drive:
    """Where a robot truly was, what its wheels say of it, and what it saw."""

    truth: Array
    odometry: Array
    events: list[object]


def drive(frames: int, carried_at: int | None = None, seed: int = 0, clutter: float = 4.0) -> Drive:
    """A robot that drives in a circle; `carried_at` an image it stands elsewhere, which its wheels do not know."""
    motion = np.array([0.0, -0.12, 0.05])
    truth, odometry = [np.array([1.0, 1.5, 0.3])], [np.zeros(3)]
    for frame in range(1, frames):
        truth.append(geometry.compose(truth[-1], motion))
        odometry.append(geometry.compose(odometry[-1], motion))
        if frame == carried_at:
            truth[-1] = np.array([-1.5, 0.5, -2.5])
    rng = np.random.default_rng(seed)
    t_ns = np.arange(frames) * SECOND // 5
    noise = EdgeNoise(detection_probability=0.8, clutter_per_frame=clutter)
    edges = simulated_edges(ROOM, CAMERA, Trajectory(t_ns, np.array(truth)), rng, noise=noise)
    pairs = zip(t_ns, odometry, edges, strict=True)
    events = [event for t, pose, seen in pairs for event in (Odometry(int(t), pose), Sighting(int(t), seen))]
    return Drive(np.array(truth), np.array(odometry), events)


def located(events: list[object], seed: int = 0, mcl: Mcl = FILTER) -> list[Located]:
    state, rng = FilterState(), np.random.default_rng(seed)
    return [found for event in events for found in step(mcl, state, event, rng)]  # type: ignore[arg-type]


def is_right(found: list[Located], truth: Array) -> Array:
    return np.array([is_near(one.estimate.pose[None], pose)[0] for one, pose in zip(found, truth, strict=True)])


# -- the whole way ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_without_a_start_is_found(seed: int) -> None:
    driven = drive(20, seed=seed)
    found = located(driven.events, seed)
    assert np.hypot(*(found[-1].estimate.pose - driven.truth[-1])[:2]) < 0.1
    assert found[-1].p_correct > 0.9 and found[-1].reason == ""
    assert len(found[-1].particles) == FILTER.parameters.particles, "as many as the way needs"
    sure = np.array([one.p_correct > 0.9 for one in found])
    assert is_right(found, driven.truth)[sure].all()


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_that_is_carried_away_is_found_again(seed: int) -> None:
    driven = drive(50, carried_at=15, seed=seed)
    start = Start(0, driven.truth[0], np.diag([0.1, 0.1, 0.05]) ** 2)
    found = located([start, *driven.events], seed)
    right = is_right(found, driven.truth)
    assert right[:15].all() and right[-10:].all()
    assert found[-1].p_correct > 0.9
    assert min(one.p_correct for one in found[15:]) < 0.9, "and says that it was lost"


def test_a_wrong_start_is_noticed() -> None:
    driven = drive(40)
    start = Start(0, np.array([-2.0, -1.5, 2.0]), np.diag([0.1, 0.1, 0.05]) ** 2)
    found = located([start, *driven.events])
    assert is_right(found, driven.truth)[-5:].all()


def test_a_search_changes_nothing_while_the_robot_is_where_it_is_believed() -> None:
    """The same particles, to the last bit, as without a search."""
    driven = drive(25)
    start = Start(0, driven.truth[0], np.diag([0.1, 0.1, 0.05]) ** 2)
    for one, other in zip(
        located([start, *driven.events]),
        located([start, *driven.events], mcl=replace(FILTER, search=None)),
        strict=True,
    ):
        np.testing.assert_array_equal(one.particles.columns, other.particles.columns)
        assert one.p_correct > 0.9


def test_edges_that_show_no_landmark_cost_confidence_and_are_named() -> None:
    driven = drive(30)
    noise = EdgeNoise(detection_probability=0.0, clutter_per_frame=25.0)
    truth = Trajectory(np.arange(30) * SECOND // 5, driven.truth)
    empty = simulated_edges(ROOM, CAMERA, truth, np.random.default_rng(5), noise=noise)
    events = [replace(event, edges=empty.pop(0)) if isinstance(event, Sighting) else event for event in driven.events]
    found = located([Start(0, driven.truth[0], np.diag([0.05, 0.05, 0.02]) ** 2), *events])
    assert found[-1].p_correct < 0.9
    assert found[-1].reason == "edges contradict the map"


# -- lost probability -------------------------------------------------------------------------------------------------


def test_the_lost_probability_grows_with_edges_that_do_not_fit_and_falls_with_edges_that_do() -> None:
    nothing, fits = np.log1p(-INLIER_RATES)[:, None] * 20, np.linspace(0, 20, len(INLIER_RATES))[:, None]
    lost, one = LostProbability.of(1e-4), np.zeros(1)
    for _ in range(3):
        before, lost = lost, lost.after(nothing, one, 1.0, 1e-3)
        assert lost.probability > before.probability
    for _ in range(20):
        lost = lost.after(nothing, one, 1.0, 1e-3)
    assert lost.probability <= 0.5, "what is not on the map explains such edges as well"
    assert lost.after(fits, one, 1.0, 1e-3).probability < 1e-3


def test_an_image_seen_before_leaves_the_lost_probability_as_it_was() -> None:
    nothing = np.log1p(-INLIER_RATES)[:, None] * 20
    assert LostProbability.of(0.1).after(nothing, np.zeros(1), 0.0, 1e-3).probability == pytest.approx(0.1)


def test_a_place_that_fits_may_be_wrong_until_others_would_have_been_found() -> None:
    fits = np.linspace(0, 20, len(INLIER_RATES))[:, None]
    lost = LostProbability.of_anywhere()
    assert lost.probability == pytest.approx(OVERLOOKED)
    chances = []
    for _ in range(6):
        lost = lost.after(fits, np.zeros(1), 1.0, 0.0)
        chances.append(lost.probability)
    assert (np.diff(chances) < 0).all() and OVERLOOKED**7 < chances[-1] < 0.01


# -- alternative hypothesis -------------------------------------------------------------------------------------------


def test_fresh_poses_keep_the_constant_errors_and_see_through_them() -> None:
    """A robot whose camera is turned by 0.02 has a heading that is as much less, and is as likely."""
    clues = SEARCH.clues(drive(1).events[1])  # type: ignore[attr-defined]
    straight, turned = (
        Particles((*POSE, CAMERA_YAW), np.array([[0.0, 0.0, 0.0, yaw]]).T, np.zeros(1)) for yaw in (0.0, 0.02)
    )
    (one, evidence), (other, same) = (
        SEARCH.fresh(like, clues, LostProbability.of(0.1).inliers, 500, np.random.default_rng(0))
        for like in (straight, turned)
    )
    assert (other[CAMERA_YAW] == 0.02).all() and same == evidence
    np.testing.assert_allclose(geometry.wrap_angle(one["heading"] - other["heading"]), 0.02)
    np.testing.assert_allclose(clues.by_rate(one), clues.by_rate(other), atol=1e-6)


def test_joined_clouds_have_the_odds_that_are_asked_for() -> None:
    both = search.joined(cloud(np.zeros((3, 3))), cloud(np.ones((5, 3)), np.arange(5.0)), np.log(0.25))
    weight = both.weight
    assert weight[3:].sum() / weight[:3].sum() == pytest.approx(0.25)
    np.testing.assert_allclose(weight[4:] / weight[3:-1], np.e)


def test_fewer_particles_are_kept_where_they_occupy_fewer_cells() -> None:
    rng = np.random.default_rng(0)
    wide, narrow = (rng.uniform(-size, size, (2000, 3)) for size in (3.0, 0.05))
    counts = [len(search.resampled(cloud(poses), 100, 2000, rng)) for poses in (wide, narrow)]
    assert counts[0] == 2000 and counts[1] < 300


def test_an_alternative_is_not_where_the_robot_is_believed_to_be() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [0.1, 0.1, 0.1], [3.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    alternative = AlternativeHypothesis(cloud(poses), LostProbability.of_anywhere(), 1.0).elsewhere(np.zeros(3))
    assert alternative is not None
    np.testing.assert_array_equal(alternative.particles.poses, poses[2:])
    assert alternative.log_odds == pytest.approx(1.0 + np.log(0.5))
    assert AlternativeHypothesis(cloud(poses[:2]), LostProbability.of_anywhere(), 1.0).elsewhere(np.zeros(3)) is None


def test_an_alternative_wins_with_one_place_not_with_many() -> None:
    rng = np.random.default_rng(0)
    one, many = rng.normal(0, 0.05, (500, 3)), rng.uniform(-3, 3, (500, 3))
    assert AlternativeHypothesis(cloud(one), LostProbability.of_anywhere(), 10.0).has_won
    assert not AlternativeHypothesis(cloud(many), LostProbability.of_anywhere(), 10.0).has_won
    assert not AlternativeHypothesis(cloud(one), LostProbability.of_anywhere(), 1.0).has_won


# -- what is said of it -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("poses", "lost", "edges", "p_correct", "reason"),
    [
        ([[0, 0, 0], [0.1, 0, 0]], 0.0, 5, 1.0, ""),
        ([[0, 0, 0], [3, 0, 0]], 0.0, 5, 0.5, "several places fit"),
        ([[0, 0, 0], [0, 0, np.pi]], 0.1, 5, 0.45, "several places fit"),
        ([[0, 0, 0], [0.1, 0, 0]], 0.7, 5, 0.3, "edges contradict the map"),
        ([[0, 0, 0], [0.1, 0, 0]], 0.7, 0, 0.3, "no edges"),
    ],
)
def test_confidence(poses: list[list[float]], lost: float, edges: int, p_correct: float, reason: str) -> None:
    particles = cloud(np.array(poses))
    found = confidence_of(particles, np.zeros(3), lost, edges == 0)
    assert found == (pytest.approx(p_correct), reason)


def test_clusters_of_belief_and_alternative_share_the_weight() -> None:
    rng = np.random.default_rng(0)
    here, there = (find_clusters(rng.normal(at, 0.02, (200, 3)), np.ones(200), mass=1.0) for at in (0.1, 2.0))
    both: Clusters = here.beside(there, 0.7)
    assert both.weight.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(both.mean[0, :2], 2.0, atol=0.1)
    assert len(both.heaviest(0.25)) <= len(both)
    assert (both.heaviest(0.25).weight >= 0.25).all()
