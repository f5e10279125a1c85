"""Bags of some kB that ask for hours or gigabytes."""

import bz2
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import lz4.frame
import numpy as np
import yaml
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2.storage_mcap import zstd
from small_bag import Recorder, bag

MB = 2**20


def clean(path: Path) -> Path:
    """Make a bag that is as it should be."""
    return bag(path, Recorder.images, "sqlite3")


def _ros1(path: Path, swell: Callable[[bytes], bytes], squeeze: str = "lz4", chunks: int = 1) -> Path:
    """Make a bag of ROS 1 with chunks that unpack to more."""
    writer = rosbag1.Writer(path.with_suffix(".bag"))
    writer.set_compression(getattr(rosbag1.Writer.CompressionFormat, squeeze.upper()))
    writer.compressor = swell
    writer.chunk_threshold = MB if chunks == 1 else 0
    with writer:
        recorder = Recorder(writer, ros1=True)
        recorder.setting()
        recorder.images(chunks)
    return path.with_suffix(".bag")


def one_chunk_of_bz2(path: Path) -> Path:
    return _ros1(path, lambda content: bz2.compress(content + bytes(200 * MB)), "bz2")


def chunks_of_lz4(path: Path) -> Path:
    """Make one whose chunks are small enough each."""
    return _ros1(path, lambda content: lz4.frame.compress(content + bytes(30 * MB)), chunks=40)


def _ros2(path: Path, mode: rosbag2.CompressionMode, change: Callable[[Recorder], None], plugin: str = "MCAP") -> Path:
    writer = rosbag2.Writer(path, version=9, storage_plugin=getattr(rosbag2.StoragePlugin, plugin))
    writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    with writer:
        change(Recorder(writer, ros1=False))
    return path


def _large_images(recorder: Recorder, count: int = 40) -> None:
    """Write all that a log needs, with images of 12 MB."""
    recorder.mount()
    recorder.info(width=4000, height=3000)
    for step in range(count):
        recorder.odometry(step * 10**8)
        recorder.image(step * 10**8, width=4000, step=4000, height=3000, data=np.zeros(12_000_000, np.uint8))


def chunks_of_mcap(path: Path) -> Path:
    """Make one with an index."""
    return _ros2(path, rosbag2.CompressionMode.STORAGE, _large_images)


def chunks_without_index(path: Path) -> Path:
    """Make one whose chunks are unpacked while it is opened."""
    file = next(chunks_of_mcap(path).glob("*.mcap"))
    data = bytearray(file.read_bytes())
    begin = int.from_bytes(data[-28:-20], "little")
    data[begin:-37] = b""
    data[-28:-12] = bytes(16)
    file.write_bytes(data)
    return file


def messages_of_zstd(path: Path) -> Path:
    return _ros2(path, rosbag2.CompressionMode.MESSAGE, _large_images, "SQLITE3")


def one_large_image(path: Path) -> Path:
    """Make one that is as it should be, compressed as a whole."""
    return _ros2(path, rosbag2.CompressionMode.FILE, lambda recorder: _large_images(recorder, 1), "SQLITE3")


def files_of_zstd(path: Path) -> Path:
    """Make a folder of files that unpack to 60 MB each."""
    _ros2(path, rosbag2.CompressionMode.FILE, lambda recorder: recorder.setting(), "SQLITE3")
    packed = next(path.glob("*.zstd"))
    content = zstd.compress(zstd.decompress(packed.read_bytes()) + bytes(60 * MB))
    names = [f"more{k}.db3.zstd" for k in range(40)]
    for name in names:
        (path / name).write_bytes(content)
    _renamed(path, names)
    return path


def one_file_many_times(path: Path) -> Path:
    clean(path)
    _renamed(path, [f"{path.name}.db3"] * 5000)
    return path


def _renamed(path: Path, names: list[str]) -> None:
    """Put the names of other files into the metadata of a bag."""
    metadata = yaml.safe_load((path / "metadata.yaml").read_text())
    metadata["rosbag2_bagfile_information"]["relative_file_paths"] = names
    (path / "metadata.yaml").write_text(yaml.safe_dump(metadata))


def merged_mappings(path: Path) -> Path:
    """Make one whose metadata has aliases that stand for 2^30 values."""
    clean(path)
    aliases = "".join(f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}\n" for k in range(1, 31))
    (path / "metadata.yaml").write_text("a0: &a0 {x: 1}\n" + aliases + (path / "metadata.yaml").read_text())
    return path


def shared_pages(path: Path) -> Path:
    """Make a database whose messages are in pages that are named 600 times by others, four times over."""
    file = clean(path) / f"{path.name}.db3"
    with closing(sqlite3.connect(file)) as database:
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    data = bytearray(file.read_bytes())
    size = int.from_bytes(data[16:18], "big")
    at, last = (root - 1) * size, len(data) // size + 1
    data += data[at : at + size]
    for _ in range(4):
        cell = struct.pack(">I", last) + b"\x01"
        head = struct.pack(">BHHHBI", 5, 0, 600, size - len(cell), 0, last)
        page = (head + struct.pack(">H", size - len(cell)) * 600).ljust(size - len(cell), b"\0") + cell
        data, last = data + page, last + 1
    data[at : at + size] = page
    data[28:32] = struct.pack(">I", len(data) // size)
    file.write_bytes(data)
    return file


def _mcap(path: Path, kind: int, records: bytes) -> Path:
    """Make a file with one chunk of these records, packed by zstd. kind: of records that follow it, without an end."""
    chunk = struct.pack("<QQQII4s", 0, 0, len(records), 0, 4, b"zstd") + struct.pack("<Q", len(zstd.compress(records)))
    chunk += zstd.compress(records)
    content = b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(chunk)) + chunk + struct.pack("<BQ", kind, 2**63 - 1)
    path.with_suffix(".mcap").write_bytes(content)
    return path.with_suffix(".mcap")


def records_of_no_kind(path: Path) -> Path:
    """Make a chunk of 7 million records that mean nothing and have no content."""
    return _mcap(path, 6, struct.pack("<BQ", 0x7F, 0) * 7_000_000)


def schemas_without_end(path: Path) -> Path:
    schemas = (struct.pack("<BQHIIII", 3, 18, number, 0, 0, 0, 0) for number in range(60_000))
    return _mcap(path, 3, b"".join(schemas))


def chunks_in_chunks(path: Path) -> Path:
    inner = struct.pack("<QQQIIQ", 0, 0, 0, 0, 0, 0)
    return _mcap(path, 6, (struct.pack("<BQ", 6, len(inner)) + inner) * 1_000_000)


SWELLING: dict[str, Callable[[Path], Path]] = {
    made.__name__: made
    for made in (
        one_chunk_of_bz2,
        chunks_of_lz4,
        chunks_of_mcap,
        chunks_without_index,
        messages_of_zstd,
        files_of_zstd,
        one_file_many_times,
        merged_mappings,
        shared_pages,
        records_of_no_kind,
        schemas_without_end,
        chunks_in_chunks,
    )
}
