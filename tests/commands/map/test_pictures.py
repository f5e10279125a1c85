"""The pictures of maps: in the style of the report, whatever the user's own; walls lie where the map has them."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from folders import ROOT
from matplotlib.figure import Figure

from localiser.commands.map import pictures
from localiser.geometry import pose_from_ros
from localiser.landmarks import LandmarkMap
from localiser.mapping import FloorPlan
from localiser.storage import read_map


def test_a_map_is_drawn_in_the_style_of_the_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path: drawn.append(figure))
    with mpl.rc_context({"axes.facecolor": "black"}):
        pictures.draw_map(read_map(ROOT / "maps" / "corridor.yaml"), tmp_path / "map.png")
    (axes,) = drawn[0].axes
    assert not axes.spines["top"].get_visible() and axes.get_facecolor() == (1.0, 1.0, 1.0, 1.0)
    assert (axes.get_title(loc="left"), axes.get_xlabel()) == ("corridor", "x (m)")


def test_the_walls_of_a_turned_plan_and_the_path_are_drawn_where_they_are() -> None:
    occupied = np.zeros((4, 6), dtype=bool)
    occupied[1, 2:5] = True
    plan = FloorPlan(occupied, ~occupied, 0.5, np.array([1.0, -2.0, np.pi / 2]))
    driven = np.array([[0.0, 0.0, 0.0], [9.0, -9.0, 0.0]])
    landmark_map = LandmarkMap.from_points(np.zeros((1, 2)))
    (axes,) = pictures.map_figure(landmark_map, "map", driven, plan).axes
    (walls,), (path,) = axes.images, axes.lines
    assert np.asarray(path.get_xydata()) == pytest.approx(driven[:, :2])
    # The outer corner of cell (column 2, row 1) is 1 m along the plan's x axis, which points along ROS's y, and 0.5 m
    # along its y axis.
    (corner,) = pose_from_ros(np.array([[1.0 - 0.5, -2.0 + 1.0, 0.0]]))[:, :2]
    drawn = (walls.get_transform() - axes.transData).transform([2.0, 1.0])
    assert drawn == pytest.approx(corner, abs=1e-9)
    (low_x, high_x), (high_z, low_z) = axes.get_xlim(), axes.get_ylim()
    for x, z in (corner, driven[1, :2]):
        assert low_x < x < high_x and low_z < z < high_z
    free = np.ones((2, 2), dtype=bool)
    without = pictures.map_figure(landmark_map, "map", None, FloorPlan(~free, free, 0.1, np.zeros(3)))
    assert np.ptp(without.axes[0].get_xlim()) < 1.0, "a plan without walls reaches nowhere"
