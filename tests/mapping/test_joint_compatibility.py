"""Which pairs of landmarks may be one, all at the same time."""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array
from localiser.mapping.loop_closure import compatible

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


def test_no_pairs_are_no_pairs() -> None:
    assert compatible(np.zeros((0, 2)), np.zeros((0, 0)), _NOISE_M).tolist() == []
