"""Near landmarks in the filter: a floor on the map of another floor of the same building, and on its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from board.run import located, run
from board.worlds import hours_of

from localiser import Localiser, read_config
from localiser.filter.belief import Belief
from localiser.observation import Matches, NearLandmarks, Sighting
from localiser.observation.place_landmarks import MEMORY_SCENES
from localiser.particles import POSE, Particles
from localiser.relocalisation import Candidates


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["line", "slope"])
def test_the_map_of_another_floor_is_found_out(kind: str) -> None:
    """Its corridor is as wide, so the likelihood believes it for most of the way; the robot passes 10 m of doors."""
    drive, other = hours_of("floor", 1, 0.7), hours_of("floor", 2, 0.1)
    told = run(drive, 1, observation=kind, start=drive.truth[0], landmark_map=other.landmark_map, same_building=False)
    first = int(told.warned.argmax())
    assert told.warned.any() and told.seconds[first] < 30.0
    assert told.sure[first:].mean() < 0.05
    right = run(drive, 1, observation=kind)
    assert not right.warned.any() and right.right.all() and right.sure.mean() > 0.95


CLOUD = Particles(POSE, np.zeros((3, 10)), np.zeros(10))
MISSED = NearLandmarks(np.arange(30), np.full(30, 9.0), np.zeros(30))


def test_landmarks_that_are_missing_speak_against_the_map_at_the_tracked_place() -> None:
    belief = Belief(0.9, 0.05, 0.0, 0.05, near=MISSED)
    assert belief.warning and belief.p_correct(CLOUD, np.zeros(3), is_tracked=True) < 0.1
    assert belief.reason(0.1, Sighting(0, measurement=np.zeros(1))) == "edges contradict the map"


def test_landmarks_that_are_missing_say_nothing_of_the_map_where_the_robot_is_elsewhere() -> None:
    """It was carried, say, and the place that is still tracked is improbable."""
    belief = Belief(0.05, 0.6, 0.25, 0.1, near=MISSED)
    assert not belief.warning
    assert belief.reason(0.1, Sighting(0, measurement=np.zeros(1))) == "several places fit"


@pytest.mark.parametrize("near", [MISSED, NearLandmarks(np.arange(9), np.full(9, 9.0), np.full(9, 9.0))])
def test_a_place_that_is_tracked_anew_is_tested_anew(near: NearLandmarks) -> None:
    """What was seen from another place speaks against the map, not for this place, and fades."""
    others = Candidates.unknown(replace(CLOUD, columns=CLOUD.columns + 5.0))
    found = Belief(0.001, 0.99, 0.0, 0.009, candidates=others, near=near).found(is_tracked=True)
    assert found is not None
    for belief in (found[1], Belief(0.9, 0.05, 0.0, 0.05, near=near).released(CLOUD)):
        assert not len(belief.near.landmark)
        assert belief.near.log_odds == min(near.log_odds, 0.0)
        later = belief.near.after(Matches.none(5, 30), np.zeros((30, 2)), np.zeros(3), 1.0)
        assert later.log_odds == pytest.approx(np.exp(-1 / MEMORY_SCENES) * belief.near.log_odds)


def test_they_are_not_asked_for_where_nothing_can_be_elsewhere() -> None:
    """With known landmarks there is no global localisation, and p_correct does not judge the map."""
    drive, other = hours_of("floor", 1, 0.1), hours_of("floor", 2, 0.1)
    robot = Localiser(other.landmark_map, drive.camera, read_config(None, ["observation.association=known"]), 0)
    robot.start(drive.truth[0], np.diag([0.1, 0.1, np.radians(3.0)]) ** 2, int(drive.t_ns[0]))
    known = [replace(one, landmark_id=np.full(len(one), -1)) for one in drive.edges]
    frames, _ = located(robot, replace(drive, edges=known))
    assert len(frames) == 30 and not len(robot.state.belief.near.landmark)
