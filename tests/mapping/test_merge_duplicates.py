"""Landmarks of one map that are there twice become one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from map_commands import run

from localiser.landmarks import LandmarkMap, Quality
from localiser.mapping import duplicates, merge_duplicates
from localiser.storage import read_map, write_map


def five() -> LandmarkMap:
    """Return three landmarks at one place, one 0.5 m away, and one as near as that with the other polarity."""
    points = np.array([[1.0, 2.0], [1.01, 2.0], [1.005, 2.01], [1.5, 2.0], [1.5, 2.01]])
    plain = LandmarkMap.from_points(points, bottom_m=np.array([0.0, 0.5, 0.0, 0.0, 0.0]), top_m=np.full(5, 2.0))
    sightings = np.array([5.0, 20.0, 10.0, 5.0, 5.0])
    quality = Quality(sightings, np.full(5, 0.3), np.full(5, 0.99), np.zeros((5, 0)))
    cov = np.tile(1e-4 * np.eye(2), (5, 1, 1))
    return replace(plain, cov=cov, quality=quality, polarity=np.array([1, 1, 0, 1, -1], dtype=np.int8))


def test_three_at_one_place_become_the_one_that_most_images_show() -> None:
    merged, gone = merge_duplicates(five())
    assert merged.ids == (1, 3, 4)
    assert sorted(other for _, other in gone) == [0, 2]
    assert merged.points[0] == pytest.approx([1.005, 2.0033], abs=1e-4)
    assert merged.cov[0] == pytest.approx(1e-4 / 3 * np.eye(2))
    assert merged.bottom_m[0] == 0.5
    assert merged.quality is not None
    assert merged.quality.sightings[0] == 20
    assert len(duplicates(merged)) == 0


def test_a_command_merges_what_the_check_lists(tmp_path: Path) -> None:
    write_map(five(), tmp_path / "map.yaml")
    assert "There twice" in run("map", "check", tmp_path / "map.yaml").output
    shown = " ".join(run("map", "merge", tmp_path / "map.yaml", "-o", tmp_path / "better.yaml").output.split())
    assert "0 is part of 1" in shown
    assert "3 landmarks" in shown
    assert "2 were there twice" in shown
    assert len(read_map(tmp_path / "better.yaml")) == 3
