"""Logs of any format are opened by one call, and a format is added by one line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from small_log import write_edge_log

from localiser.errors import InputError, OutputError
from localiser.storage import (
    FORMATS,
    FolderReader,
    Log,
    LogReader,
    ReadOptions,
    open_log,
    require_new,
    require_new_file,
    write_bytes,
)


class PointerReader:
    """Reads a file that names another log; a format of someone else."""

    format, looks_like, options = "pointer", "a file that ends in .pointer", ("topics",)

    def recognises(self, path: Path) -> bool:
        return path.suffix == ".pointer"

    def read(self, path: Path, options: ReadOptions) -> Log:
        return replace(FolderReader().read(Path(path.read_text()), options), name=options.topics.get("name", "none"))


@pytest.fixture
def pointer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    readers: list[LogReader] = [*FORMATS, PointerReader()]
    monkeypatch.setattr("localiser.storage.open.FORMATS", readers)
    write_edge_log(tmp_path / "log")
    (tmp_path / "a.pointer").write_text(str(tmp_path / "log"))
    return tmp_path / "a.pointer"


def test_a_reader_that_is_registered_reads_its_format(pointer: Path) -> None:
    assert open_log(pointer).name == "none"
    assert open_log(pointer, format="pointer", topics={"name": "x"}).name == "x"
    assert open_log(pointer.parent / "log").name != "none"


def test_what_is_said_of_a_format_is_that_of_all_registered(pointer: Path) -> None:
    with pytest.raises(InputError, match="format: expected folder, bag or pointer, found 'video'"):
        open_log(pointer, format="video")
    with pytest.raises(InputError, match=r"a ROS bag or a file that ends in \.pointer"):
        open_log(pointer.parent)
    with pytest.raises(InputError, match="--camera is for ROS bags, found a log of the format 'pointer'"):
        open_log(pointer, camera=pointer)
    with pytest.raises(InputError, match="no such log"):
        open_log(pointer.parent / "missing")


# -- files -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("durably", [False, True])
def test_interrupted_writing_leaves_what_was_there_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, durably: bool
) -> None:
    path = tmp_path / "state"
    write_bytes(path, b"before", durably=durably)

    def fail(*_: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr("os.fsync" if durably else "pathlib.Path.replace", fail)
    with pytest.raises(OutputError, match="state: cannot be written: no space left"):
        write_bytes(path, b"after", durably=durably)
    assert path.read_bytes() == b"before"
    assert [file.name for file in tmp_path.iterdir()] == ["state"]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    require_new(tmp_path)
    require_new(tmp_path / "new")
    require_new_file(tmp_path / "file")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="expected a new or empty folder, found files in it"):
        require_new(tmp_path)
    with pytest.raises(OutputError, match="expected a new file, found one that is there already"):
        require_new_file(tmp_path / "file")
