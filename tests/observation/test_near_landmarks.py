"""Near landmarks: what is tested, how it is counted, and how often a right map is taken for another one."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.geometry import Array
from localiser.observation import UNLIKELY, Matches, NearLandmarks
from localiser.observation.near_landmarks import ANOTHER, BY_CHANCE, FEWEST, MATCHED, MEMORY_SCENES, near_landmarks

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
        assert known.log_odds == 0.0 and known.probability == pytest.approx(1.0 / (1.0 + ANOTHER))


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
    for _ in range(40):
        known = after(known, np.array([True, False]))
    assert known.log_odds == pytest.approx(np.log(MATCHED * (1 - MATCHED) / (BY_CHANCE * (1 - BY_CHANCE))), rel=1e-6)


def test_what_was_seen_is_forgotten_on_the_way() -> None:
    known = after(NearLandmarks(), np.ones(4))
    gone = matches([], [False] * 4)
    for _ in range(int(5 * MEMORY_SCENES)):
        known = known.after(gone, np.zeros((4, 2)), HERE, 1.0)
    assert not len(known.landmark) and known.log_odds == 0.0


def test_a_map_of_the_building_is_hardly_ever_taken_for_another_one() -> None:
    """400 drives past 60 landmarks; by Ville's inequality fewer than 1 in 230 are ever that unlikely."""
    rng = np.random.default_rng(5)

    def least(chance: float) -> float:
        is_matched = rng.random(60) < chance
        every = np.arange(60)
        told = (NearLandmarks(every[:n], np.full(n, 50.0), 50.0 * is_matched[:n]) for n in range(1, 61))
        return min(one.probability for one in told)

    assert sum(least(MATCHED) < UNLIKELY for _ in range(400)) <= 5  # 1 in 230, at 97 %
    assert sum(least(BY_CHANCE - 0.05) < UNLIKELY for _ in range(100)) >= 80
