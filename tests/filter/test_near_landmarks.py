"""Near landmarks in the filter: a floor on the map of another floor of the same building, and on its own."""

from __future__ import annotations

import numpy as np
import pytest
from belief_run import run
from belief_worlds import hours_of

from localiser.filter.belief import Belief
from localiser.observation import NearLandmarks
from localiser.particles import POSE, Particles


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["line", "slope"])
def test_the_map_of_another_floor_is_found_out(kind: str) -> None:
    """Its corridor is as wide, so the likelihood believes it for most of the way; the robot passes 10 m of doors."""
    drive, other = hours_of("floor", 1, 0.7), hours_of("floor", 2, 0.1)
    told = run(drive, kind, 1, start=drive.truth[0], landmark_map=other.landmark_map, same_building=False)
    first = int(told.warned.argmax())
    assert told.warned.any() and told.seconds[first] < 30.0
    assert told.sure[first:].mean() < 0.05
    right = run(drive, kind, 1)
    assert not right.warned.any() and right.right.all() and right.sure.mean() > 0.95


def test_a_place_that_is_tracked_anew_is_tested_anew() -> None:
    """What was seen from another place says nothing of this one."""
    cloud = Particles(POSE, np.zeros((3, 10)), np.zeros(10))
    missed = NearLandmarks(np.arange(30), np.full(30, 9.0), np.zeros(30))
    belief = Belief(0.9, 0.05, 0.0, 0.05, near=missed)
    assert belief.warning and belief.p_correct(cloud, np.zeros(3), is_tracked=True) < 0.1
    assert not belief.released(cloud).warning
