"""`localiser map update`: what is gone is dropped, what is new appears, the old file stays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from map_commands import edge_log, refused, run
from mapping_worlds import world

from localiser.landmarks import LandmarkMap
from localiser.mapping import join_maps
from localiser.storage import read_map, write_map


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOCALISER_CACHE", str(tmp_path / "cache"))


def test_gone_and_new_landmarks(tmp_path: Path) -> None:
    """Two posts of the map stand in the corridor no more; a landmark that was often seen is not on the map yet."""
    drive = world("corridor")
    edges = drive.edges(seed=0)
    seen = np.bincount(np.concatenate([frame.landmark_id for frame in edges]) + 1)[1:]
    missing = int(seen.argmax())
    kept = np.setdiff1d(np.arange(len(drive.landmark_map)), [missing])
    posts = np.array([[-0.55, -7.3], [0.5, -7.9]])
    gone = LandmarkMap.from_points(posts, ids=("post", "pole"), bottom_m=np.zeros(2), top_m=np.full(2, 1.5))
    old = join_maps(drive.landmark_map.take(kept), gone)
    old = replace(old, cov=np.tile(1e-4 * np.eye(2), (len(old), 1, 1)))
    path, out = tmp_path / "old.yaml", tmp_path / "new.yaml"
    write_map(old, path)
    before = path.read_bytes()
    log = edge_log(tmp_path / "log", edges)
    told = run("map", "update", path, log, "-o", out)
    assert told.exit_code == 0
    new = read_map(out)
    assert not {"post", "pole"} & set(new.ids)
    assert "post" in told.output.split("Gone:")[1].split("New:")[0]
    apart = np.hypot(*(new.points - drive.landmark_map.points[missing]).T)
    assert apart.min() < 0.02
    lost = set(old.ids) - set(new.ids) - {"post", "pole"}
    assert len(lost) <= 0.05 * len(old)
    # What the drive saw well stays.
    often = {drive.landmark_map.ids[k] for k in np.flatnonzero(seen >= 10)} - {drive.landmark_map.ids[missing]}
    assert often <= set(new.ids)
    assert path.read_bytes() == before
    assert "expected a new file" in refused("map", "update", path, log, "-o", out)


def test_a_map_of_elsewhere_is_left_alone(tmp_path: Path) -> None:
    drive = world("corridor")
    path, out = tmp_path / "old.yaml", tmp_path / "new.yaml"
    write_map(LandmarkMap.from_points(drive.landmark_map.points + 100.0), path)
    log = edge_log(tmp_path / "log", drive.edges(seed=0))
    assert "frame" in refused("map", "update", path, log, "-o", out)
    assert not out.exists()
