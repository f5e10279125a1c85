"""What a run is called: another content has another name, another place on the disk has not."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from small_log import write_edge_log, write_small_log

from localiser.batch.choices import Opening, contents_of, map_id, run_id
from localiser.config import Config, read_config
from localiser.storage import read_map


def name_of(log: Path, config: Config | None = None, start: str | None = None) -> str:
    return run_id(contents_of(log, Opening()), config or Config(), start, "")


def change(file: Path, before: str, after: str) -> None:
    text = file.read_text()
    assert before in text
    file.write_text(text.replace(before, after, 1))


@pytest.mark.parametrize("write", [write_small_log, write_edge_log])
def test_a_copy_elsewhere_is_the_same(tmp_path: Path, write: object) -> None:
    log = (write_small_log if write is write_small_log else write_edge_log)(tmp_path / "log")
    assert name_of(log) == name_of(shutil.copytree(log, tmp_path / "copy"))


@pytest.mark.parametrize(
    ("file", "before", "after"),
    [
        ("images.csv", "100000000", "110000000"),
        ("odometry.csv", "-0.4", "-0.5"),
        ("map.yaml", "-1.25", "-1.5"),
        ("camera.yaml", "0.8", "0.9"),
        ("groundtruth.csv", "1.6", "1.7"),
        ("log.yaml", "170", "171"),
    ],
)
def test_whatever_is_in_a_log_counts(tmp_path: Path, file: str, before: str, after: str) -> None:
    log = write_small_log(tmp_path / "log")
    was = name_of(log)
    change(log / file, before, after)
    assert name_of(log) != was


def test_the_pixels_of_every_image_count(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log")
    was = contents_of(log, Opening())
    first, *_, last = sorted((log / "images").iterdir())
    shutil.copy(first, last)
    found = contents_of(log, Opening())
    assert found.log_id != was.log_id and found.rest_id == was.rest_id


def test_settings_start_map_and_version_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = write_small_log(tmp_path / "log")
    found = contents_of(log, Opening())
    names = {
        name_of(log),
        name_of(log, read_config(overrides=["motion.alpha1=0.3"])),
        name_of(log, Config(seed=1)),
        name_of(log, start="truth"),
        run_id(found, Config(), None, map_id(read_map(log / "map.yaml"))),
    }
    monkeypatch.setattr("localiser.batch.choices.__version__", "another")
    names.add(name_of(log))
    assert len(names) == 6


def test_a_log_that_cannot_be_read_says_why(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log")
    (log / "odometry.csv").unlink()
    assert "odometry.csv: no such file" in str(contents_of(log, Opening()).error)


def test_a_corrected_map_or_camera_leaves_the_measurements_the_same(tmp_path: Path) -> None:
    log = write_small_log(tmp_path / "log")
    was = contents_of(log, Opening())
    change(log / "map.yaml", "-1.25", "-1.5")
    found = contents_of(log, Opening())
    assert found.log_id == was.log_id and found.rest_id != was.rest_id
