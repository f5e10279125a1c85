"""Consistency of residuals: 1 for honest sigmas wherever matches are cut off, and its band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, truncnorm

from localiser.evaluate.accuracy import consistency, consistency_band, residual_figures, residual_sums
from localiser.observation import Matches

EDGES, IMAGES = 12, 400


def matches_of(residual: np.ndarray, sigma: np.ndarray, gate: float) -> Matches:
    return replace(Matches.none(len(residual), 0), residual=residual, sigma=sigma, gate=np.full(len(residual), gate))


def sums_of(gate: float, too_small: float = 1.0) -> np.ndarray:
    """Return the sums of images whose sigmas are stated `too_small` times smaller than they are."""
    rng = np.random.default_rng(0)
    rows = []
    for _ in range(IMAGES):
        sigma = rng.uniform(1e-3, 1e-2, 40)
        residual = sigma * too_small * rng.normal(size=40)
        matched = np.flatnonzero(np.abs(residual) < gate * sigma)[:EDGES]
        residual[np.setdiff1d(np.arange(40), matched)] = np.nan  # the rest is clutter
        rows.append(residual_sums(matches_of(residual, sigma, gate)))
    return np.array(rows)


@pytest.mark.parametrize("gate", [1.0, 2.5, np.inf])
def test_honest_sigmas_are_consistent_whatever_the_gate(gate: float) -> None:
    figures = residual_figures(sums_of(gate))
    assert figures["consistency"] == pytest.approx(1.0, abs=0.05)
    assert figures["images_inside_95"] == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize(("too_small", "low", "high"), [(2.0, 1.3, 4.1), (0.5, 0.2, 0.35)])
@pytest.mark.parametrize("gate", [2.5, np.inf])
def test_wrong_sigmas_are_not(gate: float, too_small: float, low: float, high: float) -> None:
    figures = residual_figures(sums_of(gate, too_small))
    assert low < figures["consistency"] < high
    assert figures["images_inside_95"] < 0.8


@pytest.mark.parametrize("gate", [0.7, 2.0, 4.0])
def test_moments_are_those_of_a_normal_variable_that_is_cut_off(gate: float) -> None:
    cut = truncnorm(-gate, gate)
    square, fourth = cut.moment(2), cut.moment(4)
    found = residual_sums(matches_of(np.array([0.02]), np.array([0.01]), gate))
    np.testing.assert_allclose(found, [4.0, square, fourth - square**2], rtol=1e-9)


def test_band_without_a_gate_is_that_of_chi_squared() -> None:
    sums = np.array([residual_sums(matches_of(np.zeros(7), np.ones(7), np.inf))])
    low, high = consistency_band(sums)
    np.testing.assert_allclose([low[0], high[0]], chi2(7).ppf([0.025, 0.975]) / 7)
    assert consistency(sums)[0] == 0.0


def test_nothing_matched_or_no_sigma_is_unknown() -> None:
    clutter = np.array([np.nan, np.nan])
    assert np.isnan(residual_sums(matches_of(clutter, clutter, np.nan))).all()
    assert np.isnan(residual_sums(replace(Matches.none(2, 0), residual=np.zeros(2)))).all()
    assert residual_figures(np.full((3, 3), np.nan)) == {"consistency": None, "images_inside_95": None}
