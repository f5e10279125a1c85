"""Coarse bearings from a log alone: refused where wheels cannot tell one landmark from the next."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from coarse_worlds import coarse_drive
from mrclam import MrclamReader

from localiser.config import read_config
from localiser.errors import InputError
from localiser.mapping import Wheels, build_map, require_association, turn_drift
from localiser.storage.log import ReadOptions

LOG = Path("log")


def wheels_turning(turn_rad: float, sigma_rad: float, steps: int) -> Wheels:
    motion = np.tile([0.0, -0.01, turn_rad], (steps, 1))
    return Wheels(motion, np.full(steps, 0.01), np.tile(np.diag([1e-6, 1e-6, sigma_rad**2]), (steps, 1, 1)))


def test_drift_is_that_of_one_turn_however_long_the_drive() -> None:
    once, thrice = (wheels_turning(2 * np.pi / 100, 0.01, steps) for steps in (100, 300))
    assert turn_drift(once) == pytest.approx(0.1)
    assert turn_drift(thrice) == pytest.approx(0.1)


def test_drift_of_a_robot_that_hardly_turns_is_that_of_its_drive() -> None:
    assert turn_drift(wheels_turning(-1e-4, 0.01, 100)) == pytest.approx(0.1)
    assert turn_drift(wheels_turning(0.0, 0.01, 100)) == pytest.approx(0.1)


def test_coarse_bearings_and_bad_wheels_are_refused_with_both_figures() -> None:
    drive = coarse_drive(0, wheel_error=1.0, seconds=60)
    with pytest.raises(InputError, match=r"found 1\.5° and \d+°.*--poses truth"):
        require_association(LOG, drive.sightings, drive.wheels)


def test_either_good_wheels_or_good_bearings_will_do() -> None:
    good, bad = coarse_drive(0, wheel_error=0.1, seconds=60), coarse_drive(0, wheel_error=1.0, seconds=60)
    require_association(LOG, good.sightings, good.wheels)
    fine = replace(bad.sightings, sigma=bad.sightings.sigma / 10)
    require_association(LOG, fine, bad.wheels)


@pytest.mark.data
@pytest.mark.parametrize("robot", [1, *(pytest.param(each, marks=pytest.mark.slow) for each in (2, 3))])
def test_a_real_robot_of_commanded_velocities_is_refused(data_dir: Path, robot: int) -> None:
    log = MrclamReader().read(data_dir / f"mrclam:{robot}", ReadOptions())
    with pytest.raises(InputError, match="nothing tells which landmark was seen"):
        build_map(log, "slam", read_config(None, [], log.settings))
