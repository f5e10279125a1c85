"""`localiser map align|merge`: files in, files out, nothing overwritten."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from map_commands import refused, run

from localiser.geometry import robot_from_map
from localiser.landmarks import LandmarkMap, Quality
from localiser.mapping import join_maps
from localiser.storage import read_map, write_map


def points(count: int = 30) -> np.ndarray:
    return np.random.default_rng(5).uniform([-6, -9], [6, 1], (count, 2))


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A map of 30 landmarks that are known to 2 cm."""
    plain = LandmarkMap.from_points(points(), name="hall", source="a log")
    unknown = np.full(30, np.nan)
    quality = Quality(np.full(30, 9.0), unknown, np.full(30, 0.9), np.zeros((30, 0)))
    path = tmp_path / "hall.yaml"
    write_map(
        replace(plain, cov=np.tile(4e-4 * np.eye(2), (30, 1, 1)), quality=quality, header={"surveyor": "Ada"}), path
    )
    return path


def test_align_and_merge(made: Path, tmp_path: Path) -> None:
    """The second map has its own frame, lacks ten landmarks and has one more."""
    pose = np.array([3.0, -4.0, 1.0])
    known = read_map(made).take(np.arange(10, 30))
    other = tmp_path / "other.yaml"
    extra = LandmarkMap.from_points(np.array([[20.0, 20.0]]), ids=("new",))
    write_map(join_maps(replace(known, points=robot_from_map(pose, known.points)), extra), other)
    out = tmp_path / "aligned.yaml"
    shown = run("map", "align", made, other, "-o", out)
    assert shown.exit_code == 0
    assert "20 of 30 and 21 landmarks match" in shown.output
    assert "turned by 57.30°" in shown.output
    assert read_map(out).points[:20] == pytest.approx(known.points, abs=1e-6)
    merged = tmp_path / "merged.yaml"
    told = run("map", "merge", made, other, "--align", "-o", merged)
    assert "31 landmarks" in told.output
    assert "20 of both maps, 10 of the first alone, 1 of the second alone" in told.output
    whole = read_map(merged)
    assert whole.points[:30] == pytest.approx(points(), abs=1e-6)
    assert whole.ids[30] == extra.ids[0]
    # Two sightings of 2 cm each are one of 1.4 cm.
    assert whole.cov[15, 0, 0] == pytest.approx(2e-4)
    assert whole.cov[5, 0, 0] == pytest.approx(4e-4)


def test_maps_that_do_not_fit_are_not_merged(made: Path, tmp_path: Path) -> None:
    far, out = tmp_path / "far.yaml", tmp_path / "out.yaml"
    write_map(LandmarkMap.from_points(points() + 100.0), far)
    assert "one frame" in refused("map", "merge", made, far, "-o", out)
    write_map(LandmarkMap.from_points(points()[:2]), far)
    assert "do not fit" in refused("map", "align", made, far, "-o", out)
    assert not out.exists()


def test_a_map_exists_already(made: Path) -> None:
    before = made.read_bytes()
    assert "expected a new file" in refused("map", "merge", made, "-o", made)
    assert "expected two maps" in refused("map", "merge", made, "--align", "-o", made.with_name("b.yaml"))
    assert made.read_bytes() == before
