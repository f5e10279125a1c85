"""Recordings that were broken off while they were written."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path


def restore(path: Path) -> None:
    """Let SQLite undo what was half written to a database when its recorder was killed.

    `rosbags` reads a database as it lies on the disk, without a look at the journal beside it. Raises sqlite3.Error.
    """
    for database in [path] if path.suffix == ".db3" else sorted(path.glob("*.db3")):
        if database.with_name(f"{database.name}-journal").exists():
            with closing(sqlite3.connect(database)) as connection:
                connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
