"""Visibility: what images tell of hidden landmarks, against Bayes' rule by hand."""

import numpy as np
import pytest

from localiser.observation import Matches, Visibility
from localiser.observation.place_landmarks import CHANGES, FOUND, FOUND_HIDDEN, USUAL


def matches(landmark: list[int], visible: list[bool]) -> Matches:
    return Matches(np.array(landmark, dtype=np.int64), np.zeros(len(landmark)), np.array(visible))


def test_nothing_is_known_at_first() -> None:
    np.testing.assert_array_equal(Visibility().of_all(3), USUAL)


def test_an_image_is_evidence_by_the_rule_of_bayes() -> None:
    known = Visibility().after(matches([2, -1, 2], [True, False, True]), 1.0)
    missed = (1 - FOUND) * USUAL / ((1 - FOUND) * USUAL + (1 - FOUND_HIDDEN) * (1 - USUAL))
    matched = FOUND * USUAL / (FOUND * USUAL + FOUND_HIDDEN * (1 - USUAL))
    np.testing.assert_allclose(known.of_all(3), [missed, USUAL, matched])


def test_a_landmark_out_of_view_is_forgotten_as_a_chain_of_two_states_has_it() -> None:
    known = Visibility().after(matches([0], [True]), 1.0)
    expected, changes = known.of_all(1)[0], (1 - np.exp(-2 * CHANGES)) / 2  # of a chain with this rate, in a scene
    for _ in range(3):
        known = known.after(matches([], [False]), 1.0)
        expected = (1 - changes) * expected + changes * (1 - expected)
    np.testing.assert_allclose(known.of_all(1), expected)
    for _ in range(20):
        known = known.after(matches([], [False]), 1.0)
    assert not len(known.landmark)


def test_an_image_of_the_same_scene_tells_nothing() -> None:
    known = Visibility().after(matches([0], [True, True]), 1.0)
    again = known.after(matches([1], [True, True]), 0.0)
    np.testing.assert_array_equal(again.of_all(2), known.of_all(2))


@pytest.mark.parametrize("is_hidden", [True, False])
def test_what_is_missed_by_chance_is_still_visible(is_hidden: bool) -> None:
    """Ten scenes of which each misses a visible landmark with 0.15, and matches a hidden one by chance with 0.1."""
    rng, known = np.random.default_rng(3), Visibility()
    wrong = 0
    for _ in range(200):
        is_matched = rng.random() < (FOUND_HIDDEN if is_hidden else FOUND)
        known = known.after(matches([0] if is_matched else [], [True]), 1.0)
        wrong += (known.of_all(1)[0] > 0.5) == is_hidden
    assert wrong < 40
