"""Make `rosbags` keep the limits of this program wherever it meets a database, a chunk or a compressed file."""

from __future__ import annotations

import os
from bz2 import BZ2Decompressor
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote

from localiser.storage.bags import limits
from localiser.storage.bags.restore import restored

_LONGEST_QOS = 10_000  # a publisher takes 600
_KEPT_BYTES = 8 * 2**20  # of the chunks read last; recorders of ROS 1 close one after 0.8 MB
MOST_MESSAGES = 1_000_000  # in a compressed chunk: `rosbags` keeps all of one chunk in memory, 0.3 kB each


@cache
def rosbag2_reader() -> type[Any]:
    """Return the reader of bags of ROS 2 whose databases, topics and chunks are checked before they are read."""
    from rosbags.rosbag2 import reader, storage_mcap, storage_sqlite3

    _bound_unpacking()

    class Database(storage_sqlite3.Sqlite3Reader):
        """A database that is restored and looked at first; a ? or % in its name is no part of an address."""

        def __init__(self, path: Any) -> None:
            super().__init__(path)
            self._file, self._copies = path, ExitStack()

        def open(self) -> None:
            with ExitStack() as copies:
                whole = copies.enter_context(restored(self._file))
                limits.check_database(whole)
                self.path = Path(quote(os.fsencode(whole.absolute())))
                super().open()
                self._copies = copies.pop_all()

        def close(self) -> None:
            super().close()
            self._copies.close()

    class Chunked(storage_mcap.McapReader):
        """An MCAP file whose topics and chunks are counted."""

        def open(self) -> None:
            super().open()
            limits.check_topics(len(self.connections))
            limits.check_chunks(self.chunks)

    class Folder(reader.DirectoryReader):
        """A folder of such files."""

        STORAGE_PLUGINS: Any = {"mcap": Chunked, "sqlite3": Database}  # noqa: RUF012 - as in its base

    class Reader(reader.Reader):
        """Any of them."""

        STORAGE_PLUGINS: Any = {"dir": Folder, ".mcap": Chunked, ".db3": Database}  # noqa: RUF012 - as in its base

    return Reader


@cache
def rosbag1_reader() -> type[Any]:
    """Return the reader of bags of ROS 1, whose chunks are unpacked no further than is allowed."""
    from rosbags.rosbag1 import reader

    _bound_unpacking()

    class Reader(reader.Reader):
        """A bag whose index is no larger than the bag, and of which some chunks are kept.

        Chunks could share an index. Messages in turn from several chunks would have each unpacked again every time.
        """

        def __init__(self, path: Path) -> None:
            super().__init__(path)
            self._kept: dict[int, bytes] = {}

        def read_chunk(self) -> Any:
            chunk = super().read_chunk()
            return chunk._replace(datasize=0, decompressor=lambda _: self._content(chunk))

        def _content(self, chunk: Any) -> bytes:
            assert self.bio is not None
            content = self._kept.pop(chunk.datapos, None)
            if content is None:
                self.bio.seek(chunk.datapos)
                content = chunk.decompressor(reader.read_bytes(self.bio, chunk.datasize))
            self._kept[chunk.datapos] = content
            while len(self._kept) > 1 and sum(map(len, self._kept.values())) > _KEPT_BYTES:
                del self._kept[next(iter(self._kept))]
            return content

        def read_index_data(self, pos: int, indexes: Any) -> None:
            assert self.bio is not None
            before = self.bio.tell()
            super().read_index_data(pos, indexes)
            limits.spend(limits.MOST_RATIO * (self.bio.tell() - before))

    return Reader


@cache
def _bound_unpacking() -> None:
    """Make `rosbags` stop where something compressed, or the description of a topic, is larger than is allowed."""
    import apsw
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import metadata, reader, storage_mcap, storage_sqlite3

    @cache
    def parsed(qos: str) -> list[Any]:
        if len(qos) > _LONGEST_QOS:
            raise ValueError(f"expected at most {_LONGEST_QOS} characters of how a topic was sent, found {len(qos)}")
        if "*" in qos:
            raise ValueError("expected plain data of how a topic was sent, found an alias")
        return metadata.parse_qos(qos)

    def lz4(data: bytes, _: int = 0) -> bytes:
        from lz4.frame import LZ4FrameDecompressor

        return limits.decompressed(LZ4FrameDecompressor(), data)

    def stored(data: bytes) -> bytes:
        limits.spend(len(data))
        return data

    apsw.connection_hooks.append(limits.bound_database)
    zstd = vars(reader)["zstd"]  # of Python's library or its backport

    class WholeFile(zstd.ZstdFile):  # type: ignore[misc, name-defined]
        """A compressed file."""

        def read(self, size: int | None = -1) -> bytes:
            data: bytes = super().read(size)
            limits.spend(len(data))
            return data

    vars(reader)["zstd"] = SimpleNamespace(decompress=zstd.decompress, open=WholeFile)
    for module in (reader, storage_mcap, storage_sqlite3):
        vars(module)["parse_qos"] = lambda qos: parsed(qos) if isinstance(qos, str) else metadata.parse_qos(qos)
    storage_mcap.DECOMPRESSORS |= {
        "": lambda data, _: stored(data),
        "lz4": lambda data, _: _counted(lz4(data)),
        "zstd": lambda data, _: _counted(limits.unpacked_zstd(data)),
    }
    ros1.decompressors |= {"none": stored, "lz4": lz4, "bz2": lambda data: limits.decompressed(BZ2Decompressor(), data)}


def _counted(chunk: bytes) -> bytes:
    """Return a chunk of MCAP if it has no more records than memory allows. Raises ValueError."""
    at, count = 0, 0
    while at < len(chunk) and count <= MOST_MESSAGES:
        at += 9 + int.from_bytes(chunk[at + 1 : at + 9], "little")
        count += 1
    if count > MOST_MESSAGES:
        raise ValueError(f"expected at most {MOST_MESSAGES} messages in a chunk, found more")
    return chunk
