"""`localiser map check`: doubles and coverage."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from map_commands import edge_log, refused, run
from mapping_worlds import world

from localiser.landmarks import LandmarkMap
from localiser.mapping import coverage, duplicates, in_view
from localiser.storage import write_camera, write_map


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOCALISER_CACHE", str(tmp_path / "cache"))


def test_doubles_are_near_and_alike() -> None:
    points = np.array([[0.0, 0.0], [0.015, 0.0], [3.0, 0.0], [3.05, 0.0], [6.0, 0.0], [6.01, 0.0], [9.0, 0.0]])
    cov = np.zeros((7, 2, 2))
    cov[2:4] = 0.03**2 * np.eye(2)
    polarity = np.array([0, 1, 1, 1, 1, -1, 0], dtype=np.int8)
    landmarks = replace(LandmarkMap.from_points(points), cov=cov, polarity=polarity)
    assert sorted(map(tuple, duplicates(landmarks).tolist())) == [(0, 1), (2, 3)]
    assert len(duplicates(LandmarkMap.from_points(points[[0, 2, 6]]))) == 0


def test_neighbours_one_behind_the_other_are_not_doubles_for_a_distance_that_all_landmarks_know_badly() -> None:
    """Seen from few degrees apart, the error that images share is larger along the line of sight than across it."""
    points = np.array([[0.0, 0.0], [0.0, 0.03], [1.0, 0.0], [1.0, 0.03], [2.0, 0.0]])
    across_m = np.array([0.006, 0.006, 0.012, 0.012, 0.006])
    cov = across_m[:, None, None] ** 2 * np.diag([1.0, 9.0])
    landmarks = replace(LandmarkMap.from_points(points), cov=cov)
    assert duplicates(landmarks).tolist() == [[2, 3]]


@pytest.mark.parametrize("shared_m", [0.006, 0.015])
def test_neighbours_are_not_doubles_for_an_error_that_all_landmarks_share(shared_m: float) -> None:
    """Two books 3 cm apart, two that a few images show badly, and a surveyed corner."""
    points = np.array([[0.0, 0.0], [0.03, 0.0], [3.0, 0.0], [3.05, 0.0], [6.0, 0.0]])
    own_m = np.array([0.001, 0.001, 0.03, 0.03, 0.0])
    cov = (own_m**2 + shared_m**2 * (own_m > 0))[:, None, None] * np.eye(2)
    landmarks = replace(LandmarkMap.from_points(points), cov=cov)
    assert duplicates(landmarks).tolist() == [[2, 3]]


def test_what_is_in_view_depends_on_the_heading() -> None:
    """Three posts ahead, none behind: some headings show all of them, as many show none."""
    camera = world("corridor").camera
    posts = LandmarkMap.from_points(np.array([[-0.5, -4.0], [0.0, -4.0], [0.5, -4.0]]))
    count = in_view(posts, camera, np.array([[0.0, 0.0]]), headings=36)[0]
    assert count[0] == 3
    assert count[18] == 0
    assert 4 <= (count == 3).sum() <= 6  # 60° of view, less the 14° that the posts take up
    found = coverage(posts, camera)
    assert ((found.share > 0.5) & (found.share <= 1.0)).all()
    assert found.median == 0


@pytest.mark.slow
def test_the_command_tells_and_draws(tmp_path: Path) -> None:
    drive = world("corridor")
    log = edge_log(tmp_path / "log", drive.edges(seed=0)[:40])
    twice = LandmarkMap.from_points(np.concatenate([drive.landmark_map.points, drive.landmark_map.points[:1] + 0.005]))
    path, picture = tmp_path / "hall.yaml", tmp_path / "hall_coverage.png"
    write_map(twice, path)
    plain = run("map", "check", path)
    assert plain.exit_code == 0
    assert f"0={len(twice) - 1}" in plain.output
    assert not picture.exists()
    checked = run("map", "check", path, "--log", log)
    assert checked.exit_code == 0
    assert "fewer than 3 from" in checked.output
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "expected a new file" in refused("map", "check", path, "--log", log, "-o", picture)
    write_camera(drive.camera, tmp_path / "camera.yaml")
    alone = run("map", "check", path, "--camera", tmp_path / "camera.yaml")
    assert "Picture in" in alone.output
