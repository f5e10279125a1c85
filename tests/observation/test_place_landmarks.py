"""What landmarks of a place tell: near ones that are missed, hidden ones by Bayes' rule; and the inlier rate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import beta

from localiser.filter.belief import MISSING
from localiser.geometry import Array
from localiser.observation import Matches, PlaceLandmarks
from localiser.observation.inlier_rate import INLIER_RATES, MEMORY_FRAMES, PRIOR_FRAMES, InlierRate
from localiser.observation.place_landmarks import (
    ANOTHER,
    BY_CHANCE,
    FEWEST_EDGES,
    MATCHED,
    NEAR_SCENES,
    SAME_WALLS,
    SEEN_SCENES,
    near_landmarks,
)

HERE = np.zeros(3)  # looks along -z
SEEN = ([9.0, 0.0], [0.0, 9.0])  # scenes that matched a landmark, and that did not


def matches(landmark: list[int], visible: list[bool], edges: int = FEWEST_EDGES) -> Matches:
    found = np.array([*landmark, *[-1] * (edges - len(landmark))], dtype=np.int64)
    return replace(Matches.none(len(found), len(visible)), landmark=found, visible=np.array(visible))


def at(range_m: float, bearing_deg: float) -> list[float]:
    """Return a point that is seen at this bearing from the origin."""
    bearing = np.radians(bearing_deg)
    return [range_m * float(np.sin(bearing)), -range_m * float(np.cos(bearing))]


def after(known: PlaceLandmarks, is_matched: Array, novelty: float = 1.0) -> PlaceLandmarks:
    """Return what is known after an image of landmarks of which none stands before another."""
    points = np.array([at(2.0, bearing) for bearing in np.linspace(-25.0, 25.0, len(is_matched))])
    found = np.flatnonzero(is_matched).tolist()
    return known.after(matches(found, [True] * len(points), max(len(points), FEWEST_EDGES)), points, HERE, novelty)


def test_near_landmarks_in_view_are_tested() -> None:
    points = np.array([at(2.0, 0.0), at(3.4, -20.0), at(3.6, 20.0), at(1.0, 25.0)])
    tested, is_matched = near_landmarks(matches([1], [True, True, True, False]), points, HERE)
    assert tested.tolist() == [0, 1] and is_matched.tolist() == [False, True]


@pytest.mark.parametrize(
    ("range_m", "bearing_deg", "is_matched", "may_hide"),
    [(1.0, 10.0, True, True), (1.0, 10.0, False, False), (1.0, 31.0, True, False), (1.9, 10.0, True, False)],
)
def test_what_may_be_behind_a_wall_is_not_tested(range_m, bearing_deg, is_matched, may_hide):
    """A landmark that is matched, nearer and beside another one may be of a wall that hides it."""
    points = np.array([at(2.0, 0.0), at(range_m, bearing_deg)])
    tested, _ = near_landmarks(matches([1] if is_matched else [], [True, True]), points, HERE)
    assert (0 not in tested) == may_hide


def test_nothing_is_known_at_first_and_by_images_that_tell_nothing() -> None:
    points, seen = np.array([at(2.0, 0.0)]), matches([0], [True])
    few = matches([0], [True], FEWEST_EDGES - 1)
    for known in (
        PlaceLandmarks(),
        PlaceLandmarks().after(few, points, HERE, 1.0),
        PlaceLandmarks().after(seen, points, HERE, 0.0),
    ):
        assert known.log_odds == 0.0 and known.probability == 1.0


def log_odds_of(matched: float, missed: float) -> float:
    """By the integral over how often an edge matches a landmark, on a map of the building and on another one."""
    here, another = (beta(*prior).expect(lambda r: r**matched * (1 - r) ** missed) for prior in (MATCHED, BY_CHANCE))
    return float(np.log(here / another))


def test_all_scenes_of_a_landmark_tell_of_one_share() -> None:
    known, scenes = PlaceLandmarks(), 0.0
    for novelty in (*[0.5] * 4, *[1.0] * 40):
        known = after(known, np.array([True, False]), novelty)
        scenes = np.exp(-novelty / NEAR_SCENES) * scenes + novelty
        assert known.log_odds == pytest.approx(log_odds_of(scenes, 0) + log_odds_of(0, scenes), rel=1e-6)
    mixed = PlaceLandmarks(np.arange(1), np.zeros((1, 2)), np.array([[3.0, 2.0]]))
    assert mixed.log_odds == pytest.approx(log_odds_of(3.0, 2.0), rel=1e-6)
    missed = PlaceLandmarks(np.arange(20), np.zeros((20, 2)), np.tile([0.0, 50.0], (20, 1)))
    odds = np.exp(20 * log_odds_of(0.0, 50.0))
    assert missed.probability == pytest.approx((1 + ANOTHER) / (1 + ANOTHER / odds))


def test_a_landmark_says_only_so_much_for_one_of_several_floors() -> None:
    """Walls may be the same on each of them; a landmark that is missed speaks against all."""
    matched, missed = (PlaceLandmarks(np.arange(3), np.zeros((3, 2)), np.tile(one, (3, 1)), maps=2) for one in SEEN)
    assert matched.log_odds == pytest.approx(3 * SAME_WALLS)
    assert replace(matched, maps=1).log_odds == pytest.approx(3 * log_odds_of(*SEEN[0]))
    assert missed.log_odds == pytest.approx(3 * log_odds_of(*SEEN[1])) and missed.log_odds < 0.0


def test_small_steps_tell_as_much_as_large_ones() -> None:
    """At 30 Hz an image is a hundredth of a scene."""
    small, large = PlaceLandmarks(), PlaceLandmarks()
    for _ in range(200):
        small = after(small, np.array([True, False, False]), 0.01)
    for _ in range(20):
        large = after(large, np.array([True, False, False]), 0.1)
    assert small.log_odds == pytest.approx(large.log_odds, rel=0.01) and small.log_odds != 0.0


def test_what_was_seen_fades_on_the_way() -> None:
    known, gone = PlaceLandmarks(), matches([], [False] * 4)
    for _ in range(10):
        known = after(known, np.ones(4))
    fresh, scenes = known.log_odds, known.near
    for _ in range(150):  # 45 m
        known = known.after(gone, np.zeros((4, 2)), HERE, 1.0)
    np.testing.assert_allclose(known.near, np.exp(-150 / NEAR_SCENES) * scenes)
    assert 0.3 < known.log_odds / fresh < 0.33
    for _ in range(int(10 * NEAR_SCENES)):
        known = known.after(gone, np.zeros((4, 2)), HERE, 1.0)
    assert not len(known.landmark) and known.log_odds == 0.0


def test_how_often_maps_are_said_not_to_fit_by_chance() -> None:
    """Drives past 60 landmarks, each matched or not, or as often as Beta has it; fewer than 1 in 230 by Ville."""
    rng = np.random.default_rng(5)

    def missing(a: float, b: float | None = None) -> bool:
        known = PlaceLandmarks()
        for _ in range(12):
            chance = (rng.random(5) < a).astype(float) if b is None else rng.beta(a, b, 5)
            points = np.array([at(2.0, bearing) for bearing in np.linspace(-25.0, 25.0, 60)])
            index = np.arange(len(known.landmark), len(known.landmark) + 5)
            visible = np.isin(np.arange(60), index)
            for _ in range(3):
                found = index[rng.random(5) < chance].tolist()
                known = known.after(matches(found, visible.tolist(), FEWEST_EDGES), points, HERE, 1.0)
            if known.probability < MISSING:
                return True
        return False

    for right in (MATCHED, (0.45,)):
        assert sum(missing(*right) for _ in range(200)) <= 4  # 1 in 230, at 99 %
    assert sum(missing(0.15) for _ in range(50)) >= 40


RATIO = 30.0  # how much likelier an edge is under a landmark that fits than under clutter


def by_rate(matched: int, clutter: int) -> Array:
    """log p(edges | w) (K, 1) of a frame with so many edges of each kind."""
    return (matched * np.log1p(INLIER_RATES * (RATIO - 1)) + clutter * np.log1p(-INLIER_RATES))[:, None]


def learnt(matched: int, clutter: int, frames: int, share: float = 1.0) -> InlierRate:
    inliers = InlierRate.unknown()
    for _ in range(frames):
        inliers = inliers.after(share).given(by_rate(matched, clutter), np.ones(1), share)
    return inliers


def test_nodes_integrate_jeffreys_prior() -> None:
    """E w^k of Beta(1/2, 1/2) is 1/2, 3/8, 5/16, …; K nodes are exact up to the power 2 K - 1."""
    expected = 1.0
    for power in range(1, 2 * len(INLIER_RATES)):
        expected *= (power - 0.5) / power
        assert InlierRate.unknown().probability @ INLIER_RATES**power == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("matched", "clutter"), [(20, 0), (10, 10), (2, 30)])
def test_the_share_is_learnt(matched: int, clutter: int) -> None:
    """As far as the prior lets go of its even share: half the distance of two nodes."""
    mean = learnt(matched, clutter, 200).probability @ INLIER_RATES
    weighted = (MEMORY_FRAMES * matched / (matched + clutter) + PRIOR_FRAMES * 0.5) / (MEMORY_FRAMES + PRIOR_FRAMES)
    assert mean == pytest.approx(weighted, abs=0.1)


def test_frames_may_differ() -> None:
    """A place where every other frame is all clutter teaches two shares, not the one in between."""
    inliers = InlierRate.unknown()
    for frame in range(100):
        of_frame = by_rate(20, 0) if frame % 2 else by_rate(0, 20)
        inliers = inliers.after(1.0).given(of_frame, np.ones(1), 1.0)
    probability = inliers.probability
    assert probability[0] > 0.3
    assert probability[-1] > 0.3
    assert probability[2:4].sum() < 0.12


def test_what_was_learnt_is_forgotten_on_the_way() -> None:
    inliers = learnt(20, 0, 60)
    even = InlierRate.unknown().probability
    distances = [np.abs(inliers.after(frames).probability - even).sum() for frames in (0, MEMORY_FRAMES, 1e3)]
    assert distances[0] > distances[1] > distances[2]
    assert distances[2] < 1e-6


def test_a_frame_seen_again_teaches_nothing() -> None:
    np.testing.assert_array_equal(learnt(20, 0, 5, share=0.0).probability, InlierRate.unknown().probability)


def test_particles_teach_by_their_weight() -> None:
    both = np.hstack([by_rate(20, 0), by_rate(0, 20)])
    unknown = InlierRate.unknown()
    for weight in ([1.0, 0.0], [0.0, 1.0]):
        alone = unknown.given(both[:, [int(weight[1])]], np.ones(1), 1.0)
        np.testing.assert_allclose(unknown.given(both, np.array(weight), 1.0).count, alone.count)


def test_a_known_share_weighs_as_that_share_would() -> None:
    inliers = InlierRate(np.eye(len(INLIER_RATES))[2] + 1e-300)
    np.testing.assert_allclose(inliers.log_mean(by_rate(3, 4)), by_rate(3, 4)[2])


@pytest.mark.parametrize("count", [1, 2000, 8191, 8192, 12_345, 100_000])
def test_particles_taken_in_parts_have_the_same_bytes(count: int) -> None:
    rates = InlierRate.unknown()
    by_rate = 30.0 * np.random.default_rng(count).standard_normal((len(INLIER_RATES), count))
    joint = by_rate + np.log(rates.probability)[:, None]
    top = joint.max(axis=0)
    assert rates.log_mean(by_rate).tobytes() == (top + np.log(np.exp(joint - top).sum(axis=0))).tobytes()


def seen_as(landmark: list[int], visible: list[bool]) -> tuple[Matches, Array, Array]:
    return matches(landmark, visible), np.tile(at(9.0, 0.0), (len(visible), 1)), HERE


def test_how_often_a_landmark_shows_is_learnt_by_the_rule_of_bayes() -> None:
    """Far ones too; every scene with a match counts for one more of them, every other one for one without."""
    (a, b), known = MATCHED, PlaceLandmarks()
    usual = a / (a + b)
    np.testing.assert_array_equal(known.shown(3), usual)
    known = known.after(*seen_as([2, -1, 2], [True, False, True]), 1.0)
    np.testing.assert_allclose(known.shown(3), [a / (a + b + 1), usual, (a + 1) / (a + b + 1)])
    assert known.log_odds == 0.0
    again = known.after(*seen_as([0], [True] * 3), 0.0)
    np.testing.assert_array_equal(again.shown(3), known.shown(3))
    for _ in range(3):
        known = known.after(*seen_as([], [False] * 3), 1.0)
    kept = np.exp(-3 / SEEN_SCENES)
    np.testing.assert_allclose(known.shown(3), [a / (a + b + kept), usual, (a + kept) / (a + b + kept)])
    for _ in range(int(12 * SEEN_SCENES)):
        known = known.after(*seen_as([], [False] * 3), 1.0)
    assert not len(known.landmark)


@pytest.mark.parametrize("is_hidden", [True, False])
def test_what_is_missed_by_chance_still_shows(is_hidden: bool) -> None:
    """Ten scenes, of which each matches a landmark that shows with 0.85, and a hidden one by chance with 0.1."""
    rng, known = np.random.default_rng(3), PlaceLandmarks()
    wrong = 0
    for _ in range(200):
        is_matched = rng.random() < (0.1 if is_hidden else 0.85)
        known = known.after(*seen_as([0] if is_matched else [], [True]), 1.0)
        wrong += (known.shown(1)[0] > 0.5) == is_hidden
    assert wrong < 40
