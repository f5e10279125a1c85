"""A recording of what came in: committed while it goes on, and a full disk ends it and not the run."""

from __future__ import annotations

import sqlite3
import time
from pathlib import Path
from typing import Any

import pytest
from recorded_texts import text, texts

from localiser.errors import InputError
from localiser.live.outputs import Recording
from localiser.storage.bags import TEXT

PATIENCE_S = 60.0


def test_a_recording_is_committed_while_it_goes_on(tmp_path: Path) -> None:
    failures: list[str] = []
    recording = Recording(tmp_path / "a.db3", failures.append)
    recording.write("/a", TEXT, 1, text("now"))
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end and not _readable(tmp_path / "a.db3"):
        time.sleep(0.05)
    assert texts(tmp_path / "a.db3") == ["now"]
    recording.write("/a", TEXT, 2, text("later"))
    recording.close()
    assert texts(tmp_path / "a.db3") == ["now", "later"] and not failures


def _readable(path: Path) -> bool:
    try:
        return bool(texts(path))
    except InputError:
        return False


def test_a_full_disk_ends_the_recording_with_a_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def connect_to_small_disk(*arguments: Any, **options: Any) -> sqlite3.Connection:
        database = connect(*arguments, **options)
        database.execute("PRAGMA max_page_count = 60")  # SQLite says that the disk is full
        return database

    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", connect_to_small_disk)
    failures: list[str] = []
    recording = Recording(tmp_path / "a.db3", failures.append)
    for k in range(200):
        recording.write("/a", TEXT, k, text("x" * 4000))
    end = time.monotonic() + PATIENCE_S
    while not failures and time.monotonic() < end:
        time.sleep(0.05)
    assert len(failures) == 1 and "full" in failures[0] and "the run goes on" in failures[0]
    recording.write("/a", TEXT, 1000, text("too late"))  # no error
    recording.close()
