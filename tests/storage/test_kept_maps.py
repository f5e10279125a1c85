"""A large map is kept as it was read, by the content of its file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from localiser.errors import InputError
from localiser.landmarks import LandmarkMap
from localiser.storage import maps, read_map, write_map
from localiser.storage.checkpoint import fingerprint


def large_map(count: int = 900) -> LandmarkMap:
    rng = np.random.default_rng(0)
    ids = tuple(f"door {k}" if k % 2 else k for k in range(count))
    return LandmarkMap.from_points(
        rng.uniform(0, 90, (count, 2)).round(3), name="large", ids=ids, bottom_m=np.zeros(count), source="hand"
    )


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("LOCALISER_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "map.yaml"
    write_map(large_map(), path)
    return path


def kept(path: Path) -> list[Path]:
    return sorted((path.parent / "cache" / "maps").glob("*"))


def never(*_: object) -> LandmarkMap:
    raise AssertionError("the text was read again")


def test_it_is_read_once_and_is_the_same_again(path, monkeypatch):
    first = read_map(path)
    monkeypatch.setattr(maps, "map_from_document", never)
    again = read_map(path)
    assert fingerprint(again) == fingerprint(first) == fingerprint(large_map())
    assert again.ids[:2] == (0, "door 1")


def test_a_file_that_changed_is_read_anew_and_its_mistakes_are_named(path):
    read_map(path)
    path.write_text(path.read_text(encoding="utf-8").replace("x: ", "x: -", 1), encoding="utf-8")
    assert read_map(path).points[0, 0] == -large_map().points[0, 0]
    assert len(kept(path)) == 2
    path.write_text(path.read_text(encoding="utf-8").replace("x: ", "y: ", 1), encoding="utf-8")
    with pytest.raises(InputError, match=r"landmarks\[0\]"):
        read_map(path)
    assert len(kept(path)) == 2


@pytest.mark.parametrize("damage", [b"", b"x" * 5000])
def test_what_is_kept_and_damaged_is_not_believed(path, damage):
    first = read_map(path)
    (file,) = kept(path)
    file.write_bytes(damage)
    assert fingerprint(read_map(path)) == fingerprint(first)


def test_a_small_map_is_not_kept(path):
    write_map(large_map(20), path)
    read_map(path)
    assert kept(path) == []
