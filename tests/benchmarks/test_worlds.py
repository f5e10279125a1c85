"""The simulated buildings of the scoreboard: they hide what they hide, and drives hit nothing."""

from __future__ import annotations

import numpy as np
import pytest
from board.buildings import KINDS
from board.worlds import MAP_SIGMA_M, clearance_m, hidden_behind, hours_of

from localiser.landmarks import in_camera

SHOWN = ("shelves", "chairs", "corridors", "alike", "crowd", "floor")


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.slow) if kind == "corridors" else kind for kind in SHOWN]
)
def test_drive_hits_nothing_and_shows_the_map(kind: str) -> None:
    drive = hours_of(kind, 1, 0.5)
    number = list(KINDS).index(kind)
    building = KINDS[kind](np.random.default_rng([1, 21, number]))
    assert clearance_m(building, drive.truth[:, :2]).min() > 0.2
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
    assert 0.5 < across_m.std() / MAP_SIGMA_M < 1.5


def test_walls_and_people_hide_what_is_behind_them() -> None:
    wall = np.array([[[-1.0, -2.0], [1.0, -2.0]]])
    person = np.array([[3.0, -2.0, 0.25]])
    points = np.array([[0.0, -4.0], [0.0, -1.0], [0.0, -2.0], [3.0, -4.0], [6.0, -4.0], [2.0, -4.0]])
    hidden = hidden_behind(np.zeros(2), points, wall, person)
    #        behind, before, on the wall; beside both; behind the person; beside the wall's end
    np.testing.assert_array_equal(hidden, [True, False, False, False, True, True])
