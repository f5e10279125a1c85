"""Columns of edges, and edges that were measured elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from localiser.edges import Edges
from localiser.edges.types import BearingSensor, complete
from localiser.errors import InputError
from localiser.landmarks import LandmarkMap, sight


def test_the_longest_edges_stay_in_their_order() -> None:
    edges = replace(Edges.from_bearings([0.1, 0.2, 0.3, 0.4], 0.01), length_px=np.array([50.0, np.nan, 200.0, 60.0]))
    np.testing.assert_array_equal(edges.longest(2).bearing, [0.3, 0.4])
    assert edges.longest(4) is edges and edges.longest(9) is edges
    unknown = Edges.from_bearings([0.1, 0.2, 0.3], 0.01)
    np.testing.assert_array_equal(unknown.longest(2).bearing, [0.1, 0.2])


angle = st.floats(-1.3, 1.3)
tilt = st.floats(0.05, 1.4) | st.floats(-1.4, -0.05)


@given(angle, st.floats(1e-4, 0.1), tilt)
def test_lean_from_bearing_and_back_is_the_same_edge(bearing: float, sigma: float, tilt_rad: float) -> None:
    b, s, unknown = np.array([bearing]), np.array([sigma]), np.array([np.nan])
    _, _, lean, lean_sigma = complete(b, s, unknown, unknown, tilt_rad)
    found, found_sigma, _, _ = complete(unknown, unknown, lean, lean_sigma, tilt_rad)
    np.testing.assert_allclose(found, b, atol=1e-12)
    np.testing.assert_allclose(found_sigma, s, rtol=1e-9)


@given(angle, st.floats(0.1, 1.4))
def test_sigma_of_the_lean_is_what_a_small_error_of_the_bearing_moves_it_by(bearing: float, tilt_rad: float) -> None:
    step = 1e-6
    both, sigmas, unknown = np.array([bearing, bearing + step]), np.full(2, step), np.full(2, np.nan)
    _, _, lean, lean_sigma = complete(both, sigmas, unknown, unknown, tilt_rad)
    np.testing.assert_allclose(lean[1] - lean[0], lean_sigma[0], rtol=1e-4)


def test_what_is_known_stays_as_it_is() -> None:
    known = [np.array([0.1]), np.array([0.01]), np.array([0.2]), np.array([0.02])]
    for found, given_value in zip(complete(*known, 0.3), known, strict=True):
        np.testing.assert_array_equal(found, given_value)


def test_without_tilt_neither_tells_of_the_other() -> None:
    unknown = np.array([np.nan])
    _, _, lean, lean_sigma = complete(np.array([0.1]), np.array([0.01]), unknown, unknown, 0.0)
    assert np.isnan(lean) and np.isnan(lean_sigma)


@pytest.mark.parametrize("range_m", [0.5, 2.0, 10.0])
def test_nominal_camera_sees_its_field_of_view_at_every_range(range_m: float) -> None:
    sensor = BearingSensor(half_view_deg=33.0)
    degrees = np.array([-35.0, -32.0, 0.0, 32.0, 35.0])
    bearing = np.radians(degrees)
    points = range_m * np.stack([np.sin(bearing), -np.cos(bearing)], axis=-1)
    seen = sight(sensor.camera(), np.zeros((1, 3)), LandmarkMap.from_points(points))
    np.testing.assert_array_equal(degrees[seen.landmark], [-32.0, 0.0, 32.0])


@pytest.mark.parametrize(
    ("bearing", "sigma", "told"),
    [
        (0.1, 0.01, r"bearing: expected \(E,\) finite numbers, found 0.1"),
        ([[0.1]], 0.01, r"bearing: expected \(E,\) finite numbers"),
        ([0.1, np.nan], 0.01, r"bearing: expected \(E,\) finite numbers"),
        (["left"], 0.01, r"bearing: expected \(E,\) finite numbers"),
        ([0.1], 0.0, "sigma: expected numbers above 0, found 0.0"),
        ([0.1], -0.01, "sigma: expected numbers above 0, found -0.01"),
        ([0.1], np.inf, r"sigma: expected one or \(1,\) finite numbers, found inf"),
        ([0.1, 0.2], [0.01] * 3, r"sigma: expected one or \(2,\) finite numbers"),
    ],
)
def test_bearings_that_cannot_be_are_refused(bearing: object, sigma: object, told: str) -> None:
    with pytest.raises(InputError, match=f"^{told}"):
        Edges.from_bearings(bearing, sigma)


def test_bearings_have_one_sigma_or_one_each() -> None:
    assert Edges.from_bearings([0, 1], 1).bearing_sigma.tolist() == [1.0, 1.0]
    assert Edges.from_bearings([0.1, 0.2], [0.01, 0.02]).bearing_sigma.tolist() == [0.01, 0.02]
    assert len(Edges.from_bearings([], 0.01)) == 0
