"""Limit the memory and the time that a bag can ask for, each time and in sum, before they are taken."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from contextvars import ContextVar
from pathlib import Path, PurePath
from typing import Any, TypeVar

from localiser.documents import Document, parse, read_text, require_regular
from localiser.storage.bags.restore import BESIDE, beside
from localiser.storage.files import inside

Made = TypeVar("Made")

MAX_METADATA_BYTES = 4 * 2**20
_TABLES = ("schema", "metadata", "topics", "message_definitions", "messages")
_MOST_TABLES = 100
_MOST_STEPS, _STEPS_AT_ONCE = 10_000, 1000  # of SQLite's machine, for a look at the tables
MOST_TOPICS = 1000  # of a bag; what rosbags does with them grows with their square
MAX_CHUNK_BYTES = 512 * 2**20  # recorders close a chunk after a few MB; one message may exceed that
MOST_RATIO = 50  # of what is compressed; recorded images come to less than 10
SMALL_BYTES = 64 * 2**20  # what anything may unpack to, however small it is


class Allowance:
    """How many bytes may still be made of a bag. most: `MOST_RATIO` times its size on the disk, or `SMALL_BYTES`."""

    def __init__(self, path: Path) -> None:
        """Take the size of a file with what SQLite put beside it, or of the files in a folder, each counted once."""
        files = path.iterdir() if path.is_dir() else [path, *(beside(path, ending) for ending in BESIDE)]
        found = [file.stat() for file in files if file.is_file()]
        self.most = most_of(sum({(each.st_dev, each.st_ino): each.st_size for each in found}.values()))
        self._left = self.most

    def spend(self, count: int) -> None:
        """Take some of it. Raises ValueError where less is left."""
        self._left -= count
        if self._left < 0:
            raise ValueError(f"expected a bag that grows at most {MOST_RATIO} times when it is read, found more")

    @contextmanager
    def in_force(self) -> Iterator[None]:
        """Let `spend`, called from within `rosbags`, take from this one."""
        token = _allowance.set(self)
        try:
            yield
        finally:
            _allowance.reset(token)

    def over(self, items: Iterator[Made]) -> Iterator[Made]:
        """Yield the items with this allowance in force while each is made."""
        while True:
            with self.in_force():
                item = next(items, None)
            if item is None:
                return
            yield item


_allowance: ContextVar[Allowance | None] = ContextVar("_allowance", default=None)


def spend(count: int) -> None:
    """Take some of the allowance that is in force. Raises ValueError where less is left."""
    if (allowance := _allowance.get()) is not None:
        allowance.spend(count)


def bound_database(connection: Any) -> None:
    """Have an apsw.Connection that is opened for a bag spend its steps from the allowance, as if each made a byte.

    Pages of a damaged database can be parts of each other: a few then hold rows without an end.
    """
    import apsw

    def go_on() -> bool:
        spend(_STEPS_AT_ONCE)
        return False

    if (allowance := _allowance.get()) is not None:
        connection.limit(apsw.SQLITE_LIMIT_LENGTH, min(MAX_CHUNK_BYTES, allowance.most))
        connection.set_progress_handler(go_on, _STEPS_AT_ONCE)


def most_of(size: int) -> int:
    """Return how many bytes may be made of something compressed."""
    return max(SMALL_BYTES, MOST_RATIO * size)


def check_files(path: Path, metadata: str) -> None:
    """Raise InputError unless a bag is a regular file, or a folder of such, and its metadata, if any, is small.

    Aliases in it are refused: rosbags merges mappings, and a few lines of aliases can stand for gigabytes.
    """
    if not path.is_dir():
        require_regular(path, "bag")
        return
    for part in sorted(path.iterdir()):
        if not part.is_dir():
            require_regular(part)
    if (path / metadata).exists():
        _check_names(path, parse(read_text(path / metadata, MAX_METADATA_BYTES), str(path / metadata)))


def _check_names(folder: Path, metadata: Document) -> None:
    """Raise InputError where metadata name a file twice, or one outside of the folder."""
    key = ("rosbag2_bagfile_information", "relative_file_paths")
    named = metadata.value
    for part in key:
        named = named.get(part) if isinstance(named, dict) else None
    seen = set()
    for place, name in enumerate(named if isinstance(named, list) else []):
        try:
            found = os.path.realpath(inside(folder, PurePath(str(name)).name))
        except ValueError as error:
            raise metadata.error((*key, place), str(error)) from None
        if found in seen:
            raise metadata.error((*key, place), "expected each file once, found one twice")
        seen.add(found)


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
        for name in {name for _, name, _ in found} & {"topics", "message_definitions"}:
            check_topics(len(database.execute(f"SELECT 1 FROM {name} LIMIT ?", (MOST_TOPICS + 1,)).fetchall()))
        for name in _TABLES:
            columns = database.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,)).fetchall()
            if any(hidden for (hidden,) in columns):
                raise ValueError(f"expected columns that hold what was recorded, found generated ones in {name}")


def check_topics(count: int) -> None:
    """Raise ValueError when a bag has more topics than are handled in a moment."""
    if count > MOST_TOPICS:
        raise ValueError(f"expected at most {MOST_TOPICS} topics, found more")


def check_chunks(chunks: Iterable[Any]) -> None:
    """Raise ValueError when a chunk of an MCAP file states to be larger than is allowed, or is read twice.

    Chunks whose times overlap are in memory together; the same limit is for their sum.
    """
    end, loaded, ends = 0, 0, []
    for chunk in sorted(chunks, key=lambda chunk: chunk.chunk_start_offset):
        found = max(chunk.compressed_size, chunk.uncompressed_size)
        if found > MAX_CHUNK_BYTES:
            raise too_large(str(found), MAX_CHUNK_BYTES)
        if chunk.chunk_start_offset < end:
            raise ValueError("expected chunks one after another, found two in one place")
        end = chunk.chunk_start_offset + chunk.compressed_size
        begin_ns, end_ns = chunk.message_start_time, chunk.message_end_time
        ends += [(begin_ns, -found), (max(begin_ns, end_ns), found)]
    for _, freed in sorted(ends):
        loaded -= freed
        if loaded > MAX_CHUNK_BYTES:
            raise ValueError(f"expected at most {MAX_CHUNK_BYTES} bytes in chunks of one time, found more")


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
    most = min(MAX_CHUNK_BYTES, most_of(len(data)))
    content: bytes = decompressor.decompress(data, most)
    spend(len(content))
    if decompressor.eof:
        return content
    if len(content) >= most:
        raise too_large("more", most)
    raise ValueError("a compressed chunk is cut off")


def too_large(found: str, most: int) -> ValueError:
    """Return the error of a chunk that is larger than is allowed."""
    return ValueError(f"expected at most {most} bytes in a chunk, found {found}")
