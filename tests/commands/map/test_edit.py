"""`localiser map add|remove|move|export|align|merge`: files in, files out, nothing overwritten unasked."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from map_commands import refused, run

from localiser.geometry import robot_from_map
from localiser.landmarks import LandmarkMap, Quality
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


def test_add_move_remove(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "new.yaml"
    assert run("map", "add", made, "--at", "1.5,-2.5", "--bottom", 0, "--top", 2, "-o", out).exit_code == 0
    added = read_map(out)
    assert added.ids[-1] == 30
    assert added.points[-1].tolist() == [1.5, -2.5]
    assert (added.bottom_m[-1], added.top_m[-1], added.source[-1]) == (0.0, 2.0, "by hand")
    assert added.header == {"surveyor": "Ada"}
    assert run("map", "move", out, "30", "--to=-1,2", "-o", out, "--force").exit_code == 0
    moved = read_map(out)
    assert moved.points[-1].tolist() == [-1.0, 2.0]
    assert moved.points[:30] == pytest.approx(points())
    assert run("map", "move", out, "3", "--to", "0,0", "-o", out, "--force").exit_code == 0
    assert np.isnan(read_map(out).cov[3]).all()
    assert run("map", "remove", out, "0", "30", "-o", out, "--force").exit_code == 0
    assert read_map(out).ids == tuple(range(1, 30))


def test_bad_edits_change_nothing(made: Path, tmp_path: Path) -> None:
    before = made.read_bytes()
    out = ("-o", made, "--force")
    assert "x,z" in refused("map", "add", made, "--at", "1.5", *out)
    assert "x,z" in refused("map", "add", made, "--at", "nan,1", *out)
    assert "already" in refused("map", "add", made, "--at", "1,1", "--id", "3", *out)
    assert "above the bottom" in refused("map", "add", made, "--at", "1,1", "--bottom", 2, "--top", 1, *out)
    assert "'99'" in refused("map", "remove", made, "3", "99", *out)
    assert "none left" in refused("map", "remove", made, *map(str, range(30)), *out)
    assert "'x'" in refused("map", "move", made, "x", "--to", "1,1", *out)
    assert "exists already" in refused("map", "remove", made, "3", "-o", made)
    assert made.read_bytes() == before
    assert list(tmp_path.glob("*")) == [made]


def test_export_as_a_table(made: Path, tmp_path: Path) -> None:
    file = tmp_path / "hall.csv"
    assert run("map", "export", made, "--csv", file).exit_code == 0
    rows = list(csv.DictReader(file.read_text().splitlines()))
    assert [float(row["x"]) for row in rows] == pytest.approx(points()[:, 0])
    assert (rows[3]["id"], rows[3]["source"], rows[3]["existence"], rows[3]["top_m"]) == ("3", "a log", "0.9", "")
    assert float(rows[0]["cov_xx"]) == pytest.approx(4e-4)
    assert run("map", "export", made).output == file.read_text()
    assert "exists already" in refused("map", "export", made, "--csv", file)


def test_align_and_merge(made: Path, tmp_path: Path) -> None:
    """The second map has its own frame, lacks ten landmarks and has one more."""
    pose = np.array([3.0, -4.0, 1.0])
    known = read_map(made).take(np.arange(10, 30))
    other = tmp_path / "other.yaml"
    extra = LandmarkMap.from_points(np.array([[20.0, 20.0]]), ids=("new",))
    run_points = robot_from_map(pose, known.points)
    write_map(replace(known, points=run_points), other)
    assert run("map", "add", other, "--at", "20,20", "--id", "new", "-o", other, "--force").exit_code == 0
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
