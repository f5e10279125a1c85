"""Limit the memory that a bag can ask for, before it is taken."""

from __future__ import annotations

from bz2 import BZ2Decompressor
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from localiser.errors import InputError

MAX_METADATA_BYTES = 4 * 2**20
MAX_CHUNK_BYTES = 512 * 2**20  # recorders close a chunk after a few MB; one message may exceed that


def check_metadata(path: Path) -> None:
    """Raise InputError when a bag's metadata.yaml, where it has one, is too large to be one."""
    if path.is_file() and (size := path.stat().st_size) > MAX_METADATA_BYTES:
        raise InputError(f"expected at most {MAX_METADATA_BYTES} bytes, found {size}", path=path)


def check_chunks(reader: Any) -> None:
    """Raise ValueError when a chunk of an open MCAP file states to be larger than is allowed."""
    storage = getattr(reader, "storage", None)
    for part in getattr(storage, "storages", [storage]):
        for chunk in getattr(part, "chunks", []):
            found = max(chunk.compressed_size, chunk.uncompressed_size)
            if found > MAX_CHUNK_BYTES:
                raise _too_large(str(found))


@cache
def bounded_decompression() -> None:
    """Make `rosbags` stop where a compressed chunk grows beyond what is allowed; a few bytes can ask for gigabytes."""
    from lz4.frame import LZ4FrameDecompressor
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import storage_mcap as mcap

    def lz4(data: bytes, _: int = 0) -> bytes:
        return _decompressed(LZ4FrameDecompressor(), data)

    mcap.DECOMPRESSORS |= {"lz4": lz4, "zstd": lambda data, _: unpacked_zstd(data)}
    ros1.decompressors |= {"lz4": lz4, "bz2": lambda data: _decompressed(BZ2Decompressor(), data)}


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
    return _decompressed(zstd.ZstdDecompressor(), data)


def _decompressed(decompressor: Any, data: bytes) -> bytes:
    content: bytes = decompressor.decompress(data, MAX_CHUNK_BYTES)
    if decompressor.eof:
        return content
    if len(content) >= MAX_CHUNK_BYTES:
        raise _too_large("more")
    raise ValueError("a compressed chunk is cut off")


def _too_large(found: str) -> ValueError:
    return ValueError(f"expected at most {MAX_CHUNK_BYTES} bytes in a chunk, found {found}")
