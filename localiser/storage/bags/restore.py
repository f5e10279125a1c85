"""Restore a database whose recorder was killed, in a copy: what a stranger made is never opened for writing."""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from localiser.documents import open_regular
from localiser.errors import InputError

BESIDE = ("-journal", "-wal")  # SQLite makes its third file, -shm, anew
_SUPER_JOURNAL = bytes.fromhex("d9d505f920a163d7")  # how a journal ends that names another file


@contextmanager
def restored(path: Path) -> Iterator[Path]:
    """Yield the path of a database with all that was committed and nothing half written.

    That is `path` itself, or a copy in a private folder which is removed in the end, if there is a journal or a log of
    changes beside it. A journal that names another file is refused: SQLite would delete that file. Raises InputError,
    sqlite3.Error, OSError.
    """
    path = Path(os.path.realpath(path))  # SQLite looks beside the file that a link leads to
    sources = [path, *(file for ending in BESIDE if _is_pending(file := beside(path, ending)))]
    if len(sources) == 1:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="localiser-") as folder:
        before = _states(sources)
        needed, free = sum(state[0] for state in before), shutil.disk_usage(folder).free
        if needed > free:
            problem = f"expected {needed} bytes of space to restore the recording in, found {free} in {folder}"
            raise InputError(f"{problem}; set TMPDIR to another folder", path=path)
        copy = Path(folder, "bag.db3")
        for source in sources:
            shutil.copyfile(source, beside(copy, source.name.removeprefix(path.name)))
        if _states(sources) != before:
            raise InputError("is being written; read it when its recorder has ended", path=path)
        journal = beside(copy, "-journal")
        if journal.exists() and _end_of(journal) == _SUPER_JOURNAL:
            problem = "expected the journal of a bag, found one that has SQLite delete another file"
            raise InputError(f"{problem}; without it the bag is read as it lies", path=beside(path, "-journal"))
        with closing(sqlite3.connect(copy)) as database:
            database.execute("PRAGMA user_version").fetchone()  # restores it, and does not read its tables
        if any(_is_pending(beside(copy, ending)) for ending in BESIDE):
            raise InputError("cannot be restored", path=path)
        yield copy


def beside(path: Path, ending: str) -> Path:
    """Return the path of what SQLite writes beside a database. ending: -journal or -wal, or nothing for itself."""
    return path.with_name(path.name + ending)


def _is_pending(path: Path) -> bool:
    """Whether SQLite would take changes from this file, or take them back. Raises InputError."""
    if not path.exists():
        return False
    with open_regular(path) as file:
        return file.read(1) not in (b"", b"\0")


def _states(paths: list[Path]) -> list[tuple[int, int]]:
    return [(found.st_size, found.st_mtime_ns) for found in (path.stat() for path in paths)]


def _end_of(path: Path) -> bytes:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - len(_SUPER_JOURNAL)))
        return file.read()
