"""Which way is up, by gyroscope and accelerometer: a robot that sways, against the truth."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.geometry import Array
from localiser.motion import GRAVITY_M_S2, up_of


def swaying(seconds: float, hz: float, bias: float, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Return times, rates, accelerations and the true up (T, 3) of a sensor that tilts by ±6° at 1 Hz."""
    t = np.arange(0.0, seconds, 1.0 / hz)
    tilt, rate = np.radians(6.0) * np.sin(2 * np.pi * t), np.radians(6.0) * 2 * np.pi * np.cos(2 * np.pi * t)
    up = np.stack([np.zeros_like(t), np.sin(tilt), np.cos(tilt)], axis=-1)
    rates = np.stack([rate, np.zeros_like(t), np.zeros_like(t)], axis=-1)
    swing = 0.3 * np.sin(2 * np.pi * 0.7 * t)[:, None] * np.array([1.0, 0.5, 0.0])  # m/s²: the robot drives to and fro
    rates = rates + bias * np.array([1.0, -1.0, 0.5]) + 1e-3 * rng.standard_normal(up.shape)
    return np.round(t * 1e9).astype(np.int64), rates, GRAVITY_M_S2 * up + swing, up


@pytest.mark.parametrize("bias", [0.0, 0.01])
def test_a_sensor_that_sways_knows_up_within_its_sigma(bias) -> None:
    t_ns, rates, accelerations, up = swaying(60.0, 100.0, bias, np.random.default_rng(1))
    found, cov = up_of(t_ns, rates, accelerations)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-9)
    late = t_ns > 20e9
    angle = np.arcsin(np.linalg.norm(np.cross(found, up), axis=1))[late]
    sigma = np.sqrt(cov[late, 0, 0])
    assert np.degrees(np.sqrt((angle**2).mean())) < 0.5
    assert (angle < 3.0 * sigma).mean() > 0.97
    leaning = np.arcsin(np.linalg.norm(np.cross(accelerations, up), axis=1) / GRAVITY_M_S2)[late]
    assert np.sqrt((angle**2).mean()) < 0.5 * np.sqrt((leaning**2).mean())  # better than the accelerometer alone


def test_a_sensor_that_falls_goes_on_by_its_gyroscope() -> None:
    t_ns, rates, accelerations, up = swaying(30.0, 100.0, 0.0, np.random.default_rng(2))
    accelerations[2000:2100] = 0.0
    found, _ = up_of(t_ns, rates, accelerations)
    angle = np.arcsin(np.linalg.norm(np.cross(found, up), axis=1))[2100]
    assert np.degrees(angle) < 1.0
