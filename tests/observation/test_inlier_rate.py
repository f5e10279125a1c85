"""The share of edges that belong to landmarks: what is learnt from frames, and what is forgotten."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.geometry import Array
from localiser.observation.inlier_rate import INLIER_RATES, MEMORY_FRAMES, PRIOR_FRAMES, InlierRate

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
