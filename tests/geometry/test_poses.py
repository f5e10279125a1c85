"""Poses one at a time and many at once."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.geometry import between, compose, wrap_angle


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e4])
def test_one_pose_is_the_same_to_the_last_bit_as_one_of_many(scale: float) -> None:
    one, other = scale * np.random.default_rng(1).normal(size=(2, 200, 3))
    for function in (compose, between):
        alone = np.array([function(a, b) for a, b in zip(one, other, strict=True)])
        assert alone.tobytes() == function(one, other).tobytes()


@pytest.mark.parametrize("angle", [0.0, -0.0, np.pi, -np.pi, 3 * np.pi, np.nextafter(np.pi, 0.0), -7.0, np.nan])
def test_one_angle_is_wrapped_to_the_last_bit_as_one_of_many(angle: float) -> None:
    assert wrap_angle(float(angle)).tobytes() == wrap_angle(np.array([angle])).tobytes()
