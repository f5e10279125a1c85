"""Floor plans: cells to map and back, and how exactly walls' corners become landmarks."""

from functools import lru_cache

import numpy as np
import pytest
from folders import ROOT
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from world_plan import cells_from_map, draw_plan, drawn_solids

from localiser.geometry import Array
from localiser.mapping import FloorPlan, map_from_cells, plan_landmarks
from localiser.simulate import World, vertical_edges
from localiser.storage import read_world

WORLDS = ROOT / "configs" / "worlds"


@lru_cache
def world(name: str) -> World:
    return read_world(WORLDS / f"{name}.yaml")


def true_corners(drawn: World) -> Array:
    """Return the true corners of what a plan of the world shows."""
    return vertical_edges(drawn_solids(drawn)).points


def corners_and_jambs(name: str) -> Array:
    """Return the corners of walls, doorways and pillars; a door frame's small steps on the wall's face are left out.

    A doorway without a frame has four corners; those of its frame are the nearest of all that are drawn.
    """
    walls = []
    for wall in world(name).walls:
        doors = tuple(door.model_copy(update={"frame_m": 0.0, "width_m": door.width_m - 0.04}) for door in wall.doors)
        walls.append(wall.model_copy(update={"doors": doors}))
    bare = true_corners(world(name).model_copy(update={"walls": tuple(walls)}))
    drawn = true_corners(world(name))
    return drawn[np.unique(cKDTree(drawn).query(bare)[1])]


def noisy(plan: FloorPlan, share: float, seed: int) -> FloorPlan:
    """Return the plan with this share of its cells turned from wall to floor or from floor to wall."""
    occupied = plan.occupied ^ (np.random.default_rng(seed).random(plan.shape) < share)
    return FloorPlan(occupied, ~occupied, plan.resolution_m, plan.origin_ros)


def square(resolution_m: float = 0.1, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> FloorPlan:
    """Return a plan of one pillar, columns 10 to 19 and rows 20 to 34."""
    occupied = np.zeros((60, 50), dtype=bool)
    occupied[20:35, 10:20] = True
    return FloorPlan(occupied, ~occupied, resolution_m, np.array(origin))


def test_ros_plan_in_our_map() -> None:
    """ROS y, up in the picture, is our -z; the origin is the lower left corner of the lower left cell."""
    plan = square(0.1, (2.0, 3.0, 0.0))
    assert map_from_cells(plan, np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])) == pytest.approx(
        np.array([[2.0, -3.0], [3.0, -3.0], [2.0, -4.0]])
    )
    turned = square(0.1, (2.0, 3.0, np.pi / 2))  # the picture's right is ROS y
    assert map_from_cells(turned, np.array([[10.0, 0.0], [0.0, 10.0]])) == pytest.approx(
        np.array([[2.0, -4.0], [1.0, -3.0]])
    )


@given(
    x=st.floats(-50, 50), y=st.floats(-50, 50), yaw=st.floats(-7, 7), size=st.floats(0.01, 1), seed=st.integers(0, 99)
)
def test_cells_to_map_and_back(x: float, y: float, yaw: float, size: float, seed: int) -> None:
    plan = square(size, (x, y, yaw))
    cells = np.random.default_rng(seed).uniform(-100, 100, (5, 2))
    assert cells_from_map(plan, map_from_cells(plan, cells)) == pytest.approx(cells, abs=1e-6)


@pytest.mark.parametrize("yaw", [0.0, 0.4, -2.0])
def test_a_pillar_has_four_corners(yaw: float) -> None:
    plan = square(origin=(1.0, -2.0, yaw))
    landmarks = plan_landmarks(plan, "hall", "plan hall.yaml")
    expected = map_from_cells(plan, np.array([[10.0, 20.0], [20.0, 20.0], [10.0, 35.0], [20.0, 35.0]]))
    distance, which = cKDTree(landmarks.points).query(expected)
    assert distance.max() < 0.01 and sorted(which) == [0, 1, 2, 3]
    assert len(landmarks) == 4
    assert landmarks.bottom_m.tolist() == [0.0] * 4
    assert landmarks.source == ("plan hall.yaml",) * 4
    assert landmarks.cov[0] == pytest.approx(np.eye(2) * 0.1**2 / 12)


def test_what_is_unknown_has_no_corners() -> None:
    """A wall that was seen from its left has no known right side."""
    plan = square()
    free = plan.free.copy()
    free[:, 20:] = False
    landmarks = plan_landmarks(FloorPlan(plan.occupied, free, 0.1, plan.origin_ros))
    assert len(landmarks) == 4  # floor goes round the ends
    free[:, 13:] = False
    left = plan_landmarks(FloorPlan(plan.occupied, free, 0.1, plan.origin_ros))
    assert left.points[:, 0] == pytest.approx([1.0, 1.0], abs=0.01)


def test_specks_and_holes_are_no_landmarks() -> None:
    plan = square(0.05)
    occupied = plan.occupied.copy()
    occupied[5, 5] = occupied[50, 40] = occupied[50, 41] = True
    occupied[27, 14] = False
    assert len(plan_landmarks(FloorPlan(occupied, ~occupied, 0.05, plan.origin_ros))) == 4


@pytest.mark.parametrize("yaw_deg", [0.0, 7.0, 45.0])
@pytest.mark.parametrize("resolution_m", [0.02, 0.05])
@pytest.mark.parametrize("name", ["corridor", "office"])
def test_corners_and_jambs_are_within_a_cell(name: str, resolution_m: float, yaw_deg: float) -> None:
    plan = draw_plan(world(name), resolution_m, np.deg2rad(yaw_deg))
    truth = corners_and_jambs(name)
    landmarks = plan_landmarks(plan)
    distance, _ = cKDTree(landmarks.points).query(truth)
    assert np.mean(distance <= resolution_m) >= 0.95
    assert np.median(distance) <= 0.7 * resolution_m
    astray, _ = cKDTree(true_corners(world(name))).query(landmarks.points)
    assert np.mean(astray > 2 * resolution_m) <= 0.03


@pytest.mark.parametrize(("resolution_m", "yaw_deg"), [(0.02, 0.0), (0.02, 30.0), (0.05, 0.0), (0.05, 20.0)])
@pytest.mark.parametrize("name", ["corridor", "office"])
def test_noise_of_pixels_does_little(name: str, resolution_m: float, yaw_deg: float) -> None:
    plan = draw_plan(world(name), resolution_m, np.deg2rad(yaw_deg))
    truth = corners_and_jambs(name)
    found = []
    for seed in range(3):
        distance, _ = cKDTree(plan_landmarks(noisy(plan, 0.005, seed)).points).query(truth)
        found.append(np.mean(distance <= resolution_m))
    assert np.mean(found) >= 0.95
