"""Whether a path that was found agrees with the wheels."""

from __future__ import annotations

import numpy as np
import pytest

from localiser.geometry import Array
from localiser.mapping import Prior
from localiser.mapping.factors import Wheels
from localiser.mapping.loop_closure import contradicting_steps, contradiction
from localiser.mapping.smooth import dead_reckoning

PRIOR = Prior(np.zeros(4), np.array([0.02, 0.03, 0.01, 0.02]))
SIGMA = np.array([0.01, 0.01, 0.003])


def driven(seed: int, steps: int = 200) -> tuple[Wheels, Array]:
    """Return what wheels say of a drive along a curve, and where the robot was."""
    motion = np.tile([0.0, -0.1, 0.02], (steps, 1))
    cov = np.tile(np.diag(SIGMA**2), (steps, 1, 1))
    exact = Wheels(motion, np.full(steps, 0.1), cov)
    noise = SIGMA * np.random.default_rng(seed).standard_normal((steps, 3))
    return Wheels(motion + noise, exact.path_m, cov), dead_reckoning(exact)


@pytest.mark.parametrize("steps", [200, 20000])
@pytest.mark.parametrize("seed", range(10))
def test_the_true_path_agrees(seed: int, steps: int) -> None:
    wheels, poses = driven(seed, steps)
    assert contradiction(wheels, PRIOR, poses, np.zeros(4)) is None
    assert len(contradicting_steps(wheels, poses, np.zeros(4))) == 0


def test_a_path_that_a_wrong_loop_bent_contradicts_the_noise() -> None:
    wheels, poses = driven(0)
    bent = poses.copy()
    bent[:, 0] += 0.8 * np.clip((np.arange(len(poses)) - 90) / 20, 0, 1)  # 0.8 m to the side within two metres
    assert "from image" in str(contradiction(wheels, PRIOR, bent, np.zeros(4)))


@pytest.mark.parametrize("seed", range(5))
def test_steps_that_the_wheels_did_not_make_are_named(seed: int) -> None:
    wheels, poses = driven(seed)
    assert len(contradicting_steps(wheels, poses, np.zeros(4))) == 0
    poses[43:, 0] += 0.1
    poses[120:, 1] -= 0.1
    assert contradicting_steps(wheels, poses, np.zeros(4)).tolist() == [42, 119]


def test_a_scale_that_wheels_cannot_have_is_named() -> None:
    wheels, poses = driven(0)
    found = contradiction(wheels, PRIOR, poses, np.array([0.1, 0.0, 0.0, 0.0]))
    assert "5.0 sigmas off (distance scale)" in str(found)
