"""The simulated hours of benchmarks/belief.py: buildings that hide what they hide, drives that hit nothing."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from folders import ROOT

from localiser.landmarks import in_camera

KINDS = ("shelves", "chairs", "corridors", "alike", "crowd", "floor")


@pytest.fixture(scope="module")
def worlds() -> Iterator[SimpleNamespace]:
    """Return the modules of the benchmark, which is not a package."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    import belief_buildings
    import belief_worlds

    yield SimpleNamespace(buildings=belief_buildings, worlds=belief_worlds)
    sys.path.remove(str(ROOT / "benchmarks"))


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.slow) if kind == "corridors" else kind for kind in KINDS]
)
def test_drive_hits_nothing_and_shows_the_map(worlds: SimpleNamespace, kind: str) -> None:
    drive = worlds.worlds.hours_of(kind, 1, 0.5)
    number = list(worlds.buildings.KINDS).index(kind)
    building = worlds.buildings.KINDS[kind](np.random.default_rng([1, 21, number]))
    assert worlds.worlds.clearance_m(building, drive.truth[:, :2]).min() > 0.2
    assert len(drive.t_ns) == len(drive.edges) == 150
    # Edges of landmarks point where the landmark stands, but for the errors of the map.
    errors = []
    for edges, pose in zip(drive.edges, drive.truth, strict=True):
        known = edges.landmark_id >= 0
        eye = drive.camera.pose_in_map(pose[None])
        right, ahead = (axis[0] for axis in in_camera(eye, drive.landmark_map.points[edges.landmark_id[known]]))
        errors.append(np.hypot(right, ahead) * (edges.bearing[known] - np.arctan2(right, ahead)))
    across_m = np.concatenate(errors)
    assert len(across_m) > 100
    assert 0.5 < across_m.std() / worlds.worlds.MAP_SIGMA_M < 1.5


def test_same_seed_gives_the_same_drive(worlds: SimpleNamespace) -> None:
    one, again, other = (worlds.worlds.hours_of("chairs", seed, 0.2) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.truth, again.truth)
    np.testing.assert_array_equal(one.odometry.poses, again.odometry.poses)
    for edges, same in zip(one.edges, again.edges, strict=True):
        np.testing.assert_array_equal(edges.bearing, same.bearing)
    assert not np.array_equal(one.truth, other.truth)


def test_walls_and_people_hide_what_is_behind_them(worlds: SimpleNamespace) -> None:
    wall = np.array([[[-1.0, -2.0], [1.0, -2.0]]])
    person = np.array([[3.0, -2.0, 0.25]])
    points = np.array([[0.0, -4.0], [0.0, -1.0], [0.0, -2.0], [3.0, -4.0], [6.0, -4.0], [2.0, -4.0]])
    hidden = worlds.worlds.hidden_behind(np.zeros(2), points, wall, person)
    #        behind, before, on the wall; beside both; behind the person; beside the wall's end
    np.testing.assert_array_equal(hidden, [True, False, False, False, True, True])


def test_people_show_their_outline_from_wherever_they_are_seen(worlds: SimpleNamespace) -> None:
    building = worlds.buildings.Building((5.0, 5.0), np.random.default_rng(0))
    mover = worlds.buildings.Mover(np.array([0.0, 0.0]), np.array([4.0, 0.0]), 1.0, 0.2)
    building.movers.append(mover)
    for seconds, x in ((1.0, 1.0), (6.0, 2.0), (8.0, 0.0)):
        np.testing.assert_allclose(mover.at(seconds)[0], [x, 0.0], atol=1e-9)
    for eye in (np.array([1.0, 3.0]), np.array([-4.0, 1.0])):
        rows, bodies = worlds.worlds.moving_edges(building, eye, 1.0)
        np.testing.assert_allclose(bodies, [[1.0, 0.0, 0.2]])
        np.testing.assert_allclose((rows[:, :2] - [1.0, 0.0]) @ (eye - [1.0, 0.0]), 0.0, atol=1e-9)


def test_false_recovery_is_a_jump_away_from_the_truth(worlds: SimpleNamespace) -> None:
    import belief_run
    import belief_scenarios

    def record(error_m: list[float]) -> belief_run.Record:
        count, error = len(error_m), np.column_stack([error_m, np.zeros((len(error_m), 2))])
        none = np.zeros(count)
        return belief_run.Record(none, error, none, none > 0, none, none, none, none)

    assert belief_scenarios.false_recoveries(record([0.1, 0.1, 4.0, 4.0, 0.1, -3.0])) == 2
    assert belief_scenarios.false_recoveries(record([0.1, 0.3, 0.45, 0.55, 0.7])) == 0  # it drifted
    assert belief_scenarios.false_recoveries(record([4.0, 0.1, 0.2])) == 0  # it came back
