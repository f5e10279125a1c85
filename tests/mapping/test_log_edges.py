"""The cache of a log's edges: it removes nothing but its own, oldest files."""

from __future__ import annotations

import os
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_log import write_small_log

from localiser.camera import RollingShutter
from localiser.config import read_config
from localiser.geometry import Trajectory
from localiser.mapping import cache_folder
from localiser.mapping.recorded import edges_of_log
from localiser.storage import open_log


def test_files_of_others_in_the_cache_are_never_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOCALISER_CACHE", str(tmp_path))
    cache = cache_folder()
    cache.mkdir()
    theirs = [folder / f"{k:032x}.npz" for folder in (tmp_path, cache) for k in range(60)]
    ours = [cache / f"edges-{k:032x}.npz" for k in range(60)]
    for age, file in enumerate([*theirs, *ours]):
        file.write_bytes(b"")
        os.utime(file, (age, age))
    log = open_log(write_small_log(tmp_path / "log", ".png"))
    edges_of_log(log, read_config(None).edges, cache=cache)
    assert all(file.exists() for file in theirs)
    assert sum(file.exists() for file in ours) == 49, "and the one that is new"


@pytest.mark.parametrize("count", [["x"], [1.5], [-1], [7], 3, [[1]]])
def test_a_cache_of_other_types_is_passed_over(tmp_path: Path, count: object) -> None:
    log, parameters, cache = (
        open_log(write_small_log(tmp_path / "log", ".png")),
        read_config(None).edges,
        tmp_path / "c",
    )
    found = edges_of_log(log, parameters, cache=cache)
    (file,) = cache.iterdir()
    with np.load(file) as content:
        columns = dict(content)
    np.savez(file, **columns | {"count": np.array(count)})
    again = edges_of_log(log, parameters, cache=cache)
    assert [edges.bearing.tolist() for edges in again] == [edges.bearing.tolist() for edges in found]


@pytest.mark.parametrize("at", ["method", "encrypted", "header"])
def test_a_cache_that_the_readers_of_numpy_and_zip_cannot_read_is_passed_over(tmp_path: Path, at: str) -> None:
    """Found by benchmarks/attack.py: they raise NotImplementedError, RuntimeError and TokenError for these."""
    log, parameters = open_log(write_small_log(tmp_path / "log", ".png")), read_config(None).edges
    found = edges_of_log(log, parameters, cache=tmp_path / "c")
    (file,) = (tmp_path / "c").iterdir()
    if at == "header":
        with zipfile.ZipFile(file) as written:
            members = {name: written.read(name) for name in written.namelist()}
        with zipfile.ZipFile(file, "w") as damaged:
            for name, content in members.items():
                damaged.writestr(name, content.replace(b"}", b"(", 1))
    else:
        content = bytearray(file.read_bytes())
        directory = content.index(b"PK\x01\x02")
        if at == "method":
            content[directory + 10] = content[8] = 99
        else:
            content[directory + 8] |= 1
            content[6] |= 1
        file.write_bytes(content)
    again = edges_of_log(log, parameters, cache=tmp_path / "c")
    assert [edges.bearing.tolist() for edges in again] == [edges.bearing.tolist() for edges in found]


def test_edges_of_a_rolling_shutter_are_kept_by_how_the_robot_moved(tmp_path: Path) -> None:
    log, parameters = open_log(write_small_log(tmp_path / "log", ".png")), read_config(None).edges
    rolling = replace(log, camera=replace(log.camera, shutter=RollingShutter(600e-6)))
    turning = Trajectory(log.odometry.t_ns, log.odometry.poses + np.outer(log.odometry.t_ns / 1e9, [0.0, 0.0, 1.0]))
    for each in (log, rolling, replace(rolling, odometry=turning), rolling):
        edges_of_log(each, parameters, cache=tmp_path / "c")
    assert len(list((tmp_path / "c").iterdir())) == 3
