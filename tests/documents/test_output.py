"""Drafts: whoever is writing beside us, and whatever lies there, is not touched."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from localiser.documents import drafted, dump, parse, write_text
from localiser.errors import InputError, OutputError


def test_two_that_write_one_path_at_once_do_not_meet(tmp_path: Path) -> None:
    path = tmp_path / "log"
    with pytest.raises(OutputError, match="log: cannot be written"), drafted(path) as other, drafted(path) as one:
        for number, folder in enumerate((one, other)):
            folder.mkdir()
            (folder / "whose").write_text(str(number))
    assert (path / "whose").read_text() == "0", "the first to end"
    assert [file.name for file in tmp_path.iterdir()] == ["log"]


def test_what_is_new_is_not_written_over_what_came_in_between(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with pytest.raises(OutputError, match="expected a path where nothing is"), drafted(path, is_new=True) as draft:
        draft.write_text("second")
        path.write_text("first")
    assert path.read_text() == "first"
    assert [file.name for file in tmp_path.iterdir()] == ["a.mcap"]


def test_a_folder_of_the_users_is_not_taken_for_a_draft(tmp_path: Path) -> None:
    (tmp_path / ".text.part").mkdir()
    (tmp_path / ".text.part" / "mine").write_text("mine")
    write_text(tmp_path / "text", "\udcff ü")
    assert (tmp_path / ".text.part" / "mine").read_text() == "mine"
    assert (tmp_path / "text").read_text() == "\\udcff ü"


def test_a_name_as_long_as_the_system_allows_can_be_written(tmp_path: Path) -> None:
    write_text(tmp_path / ("x" * 255), "content")
    assert (tmp_path / ("x" * 255)).read_text() == "content"


def test_a_name_that_is_no_text_is_written_as_its_escape() -> None:
    name = os.fsdecode(b"b\xff")
    assert parse(dump({"path": name, "parts": [name]}), "").value == {"path": "b\\udcff", "parts": ["b\\udcff"]}


def test_an_error_is_one_paragraph_that_a_terminal_does_not_act_on() -> None:
    said = str(InputError("expected x,\n  found \x1b[2J", path="a\u202eb", line=3))
    assert said == "a\\u202eb:3: expected x, found \\x1b[2J"
    assert len(str(InputError("a" * 10**6))) < 3000


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with names")
def test_a_pipe_or_a_device_is_not_written_over(tmp_path: Path) -> None:
    """Root could put a file in the place of /dev/null."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    (tmp_path / "null").symlink_to(os.devnull)
    for name in ("pipe", "link", "null"):
        with pytest.raises(OutputError, match=f"{name}: expected a file, or a path where nothing is, found a device"):
            write_text(tmp_path / name, "text")
    assert (tmp_path / "pipe").is_fifo() and Path(os.devnull).is_char_device()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "null", "pipe"]
