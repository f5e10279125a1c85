"""Near landmarks: what is tested, how it is counted, and how often a right map is taken for another one."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.geometry import Array
from localiser.observation import Matches, NearLandmarks
from localiser.observation.place_landmarks import ANOTHER, BY_CHANCE, FEWEST, MATCHED, MEMORY_SCENES, near_landmarks

HERE = np.zeros(3)  # looks along -z


def matches(landmark: list[int], visible: list[bool], edges: int = FEWEST) -> Matches:
    found = np.array([*landmark, *[-1] * (edges - len(landmark))], dtype=np.int64)
    return Matches(found, np.zeros(len(found)), np.array(visible))


def at(range_m: float, bearing_deg: float) -> list[float]:
    """Return a point that is seen at this bearing from the origin."""
    bearing = np.radians(bearing_deg)
    return [range_m * float(np.sin(bearing)), -range_m * float(np.cos(bearing))]


def after(known: NearLandmarks, is_matched: Array, novelty: float = 1.0) -> NearLandmarks:
    """Return what is known after an image of landmarks of which none stands before another."""
    points = np.array([at(2.0, bearing) for bearing in np.linspace(-25.0, 25.0, len(is_matched))])
    found = np.flatnonzero(is_matched).tolist()
    return known.after(matches(found, [True] * len(points), max(len(points), FEWEST)), points, HERE, novelty)


def test_near_landmarks_in_view_are_tested() -> None:
    points = np.array([at(2.0, 0.0), at(3.4, -20.0), at(3.6, 20.0), at(1.0, 25.0)])
    tested, is_matched = near_landmarks(matches([1], [True, True, True, False]), points, HERE)
    assert tested.tolist() == [0, 1] and is_matched.tolist() == [False, True]


@pytest.mark.parametrize(
    ("range_m", "bearing_deg", "is_matched", "may_hide"),
    [(1.0, 10.0, True, True), (1.0, 10.0, False, False), (1.0, 31.0, True, False), (1.9, 10.0, True, False)],
)
def test_what_may_be_behind_a_wall_is_not_tested(
    range_m: float, bearing_deg: float, is_matched: bool, may_hide: bool
) -> None:
    """A landmark that is matched, nearer and beside another one may be of a wall that hides it."""
    points = np.array([at(2.0, 0.0), at(range_m, bearing_deg)])
    tested, _ = near_landmarks(matches([1] if is_matched else [], [True, True]), points, HERE)
    assert (0 not in tested) == may_hide


def test_nothing_is_known_at_first_and_by_images_that_tell_nothing() -> None:
    points, seen = np.array([at(2.0, 0.0)]), matches([0], [True])
    few = matches([0], [True], FEWEST - 1)
    for known in (
        NearLandmarks(),
        NearLandmarks().after(few, points, HERE, 1.0),
        NearLandmarks().after(seen, points, HERE, 0.0),
    ):
        assert known.log_odds == 0.0 and known.probability == 1.0


def test_each_landmark_counts_once_however_often_it_is_seen() -> None:
    """By the sum of the module, landmark by landmark."""
    known = NearLandmarks()
    for _ in range(4):
        known = after(known, np.array([True, False]), 0.5)
    kept = np.exp(-0.5 / MEMORY_SCENES)
    scenes = 0.5 * (1 + kept + kept**2 + kept**3)
    weight = 1 - np.exp(-scenes)
    expected = weight * np.log(MATCHED / BY_CHANCE) + weight * np.log((1 - MATCHED) / (1 - BY_CHANCE))
    assert known.log_odds == pytest.approx(expected)
    missed = NearLandmarks(np.arange(20), np.full(20, 50.0), np.zeros(20))
    odds = ((1 - MATCHED) / (1 - BY_CHANCE)) ** 20
    assert missed.probability == pytest.approx((1 + ANOTHER) / (1 + ANOTHER / odds))
    for _ in range(40):
        known = after(known, np.array([True, False]))
    assert known.log_odds == pytest.approx(np.log(MATCHED * (1 - MATCHED) / (BY_CHANCE * (1 - BY_CHANCE))), rel=1e-6)


def test_small_steps_tell_as_much_as_large_ones() -> None:
    """At 30 Hz an image is a hundredth of a scene."""
    small, large = NearLandmarks(), NearLandmarks()
    for _ in range(200):
        small = after(small, np.array([True, False, False]), 0.01)
    for _ in range(20):
        large = after(large, np.array([True, False, False]), 0.1)
    assert small.log_odds == pytest.approx(large.log_odds, rel=0.01) and small.log_odds != 0.0


def test_what_was_seen_fades_on_the_way() -> None:
    known, gone = NearLandmarks(), matches([], [False] * 4)
    for _ in range(10):
        known = after(known, np.ones(4))
    seen, fresh = known.scenes[0], known.log_odds
    for _ in range(150):  # 45 m
        known = known.after(gone, np.zeros((4, 2)), HERE, 1.0)
    assert known.log_odds == pytest.approx(fresh * (1 - np.exp(-seen * np.exp(-150 / MEMORY_SCENES))), rel=1e-3)
    assert 0.4 < known.log_odds / fresh < 0.6
    for _ in range(int(10 * MEMORY_SCENES)):
        known = known.after(gone, np.zeros((4, 2)), HERE, 1.0)
    assert not len(known.landmark) and known.log_odds == 0.0


def test_how_often_maps_are_said_not_to_fit_by_chance() -> None:
    """Drives past 60 landmarks, each matched or not; on a map of the building fewer than 1 in 230 by Ville."""
    rng = np.random.default_rng(5)

    def missing(chance: float) -> bool:
        known = NearLandmarks()
        for _ in range(12):
            is_matched = rng.random(5) < chance
            points = np.array([at(2.0, bearing) for bearing in np.linspace(-25.0, 25.0, 60)])
            index = np.arange(len(known.landmark), len(known.landmark) + 5)
            visible = np.isin(np.arange(60), index)
            for _ in range(3):
                found = index[is_matched].tolist()
                known = known.after(matches(found, visible.tolist(), FEWEST), points, HERE, 1.0)
            if known.are_missing:
                return True
        return False

    assert sum(missing(MATCHED) for _ in range(200)) <= 4  # 1 in 230, at 99 %
    assert sum(missing(0.15) for _ in range(50)) >= 40
