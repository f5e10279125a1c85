"""Limit the memory that a bag can ask for, before it is taken."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

from localiser.documents import read_bytes, require_regular

MAX_METADATA_BYTES = 4 * 2**20
_TABLES = ("schema", "metadata", "topics", "message_definitions", "messages")
_MOST_TABLES = 100
_MOST_STEPS, _STEPS_AT_ONCE = 10_000, 1000  # of SQLite's machine, for a look at the tables
MOST_TOPICS = 1000  # of a bag; what rosbags does with them grows with their square
MAX_CHUNK_BYTES = 512 * 2**20  # recorders close a chunk after a few MB; one message may exceed that


def check_files(path: Path, metadata: str) -> None:
    """Raise InputError unless a bag is a regular file, or a folder of such, and its metadata, if any, is small."""
    if not path.is_dir():
        require_regular(path, "bag")
        return
    for part in sorted(path.iterdir()):
        if not part.is_dir():
            require_regular(part)
    if (path / metadata).exists():
        read_bytes(path / metadata, MAX_METADATA_BYTES)


def check_database(path: Path) -> None:
    """Raise ValueError unless a database has tables as ROS 2 makes them, which hold what the file holds and no more.

    A column that is generated, a view or a virtual table can make gigabytes of nothing.
    """
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)) as database:
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
        steps = iter(range(_MOST_STEPS))
        database.set_progress_handler(lambda: next(steps, None) is None, _STEPS_AT_ONCE)
        found = database.execute(
            "SELECT type, name, rootpage FROM sqlite_master LIMIT ?", (_MOST_TABLES + 1,)
        ).fetchall()
        kinds = {kind for kind, _, _ in found}
        if len(found) > _MOST_TABLES or kinds - {"table", "index"} or any(page == 0 for _, _, page in found):
            raise ValueError(f"expected at most {_MOST_TABLES} plain tables, found others")
        if any(name == "topics" for _, name, _ in found):
            check_topics(len(database.execute("SELECT 1 FROM topics LIMIT ?", (MOST_TOPICS + 1,)).fetchall()))
        for name in _TABLES:
            columns = database.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,)).fetchall()
            if any(hidden for (hidden,) in columns):
                raise ValueError(f"expected columns that hold what was recorded, found generated ones in {name}")


def check_topics(count: int) -> None:
    """Raise ValueError when a bag has more topics than are handled in a moment."""
    if count > MOST_TOPICS:
        raise ValueError(f"expected at most {MOST_TOPICS} topics, found more")


def check_chunks(chunks: Iterable[Any]) -> None:
    """Raise ValueError when a chunk of an MCAP file states to be larger than is allowed, or is read twice."""
    end = 0
    for chunk in sorted(chunks, key=lambda chunk: chunk.chunk_start_offset):
        found = max(chunk.compressed_size, chunk.uncompressed_size)
        if found > MAX_CHUNK_BYTES:
            raise too_large(str(found))
        if chunk.chunk_start_offset < end:
            raise ValueError("expected chunks one after another, found two in one place")
        end = chunk.chunk_start_offset + chunk.compressed_size


def message_unpacker(reader: Any) -> Callable[[bytes], bytes]:
    """Return what unpacks the messages of an open bag, and keep `rosbags` from doing so without a limit."""
    storage = getattr(reader, "storage", None)
    if storage is None or storage.metadata.compression_mode != "message":
        return lambda data: data
    storage.metadata = storage.metadata._replace(compression_mode=None)
    return unpacked_zstd


def unpacked_zstd(data: bytes) -> bytes:
    """Return what a zstd frame holds. Raises ValueError when that is more than a chunk may be, or cut off."""
    from rosbags.rosbag2 import storage_mcap

    zstd: Any = vars(storage_mcap)["zstd"]  # of Python's library or its backport
    return decompressed(zstd.ZstdDecompressor(), data)


def decompressed(decompressor: Any, data: bytes) -> bytes:
    """Return what a decompressor makes of `data`. Raises ValueError when that is more than a chunk may be, or cut off.

    A few bytes can ask for gigabytes.
    """
    content: bytes = decompressor.decompress(data, MAX_CHUNK_BYTES)
    if decompressor.eof:
        return content
    if len(content) >= MAX_CHUNK_BYTES:
        raise too_large("more")
    raise ValueError("a compressed chunk is cut off")


def too_large(found: str) -> ValueError:
    """Return the error of a chunk that is larger than is allowed."""
    return ValueError(f"expected at most {MAX_CHUNK_BYTES} bytes in a chunk, found {found}")
