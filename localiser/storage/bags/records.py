"""Read the records of an MCAP file or a ROS 1 bag, one after another from the front.

Nothing of an index is believed but the list of topics: a record is read once, however often an index names it, and a
file that was never closed is read up to where it ends. What is compressed is unpacked no further than is allowed.
"""

from __future__ import annotations

import struct
from binascii import crc32
from bz2 import BZ2Decompressor
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from struct import iter_unpack, unpack_from
from typing import Any, BinaryIO, NamedTuple

MOST_TOPICS = 1000  # of a bag
MAX_CHUNK_BYTES = 512 * 2**20  # recorders close a chunk after a few MB; one message may exceed that
MOST_RATIO = 50  # of what is compressed; recorded images come to less than 10
SMALL_BYTES = 64 * 2**20  # what anything may unpack to, however small it is
RECORD_BYTES = 100  # what reading a record costs, however short it is


class RosType:
    """Types of the messages that are read and written, as ROS 2 calls them."""

    IMAGE = "sensor_msgs/msg/Image"
    COMPRESSED = "sensor_msgs/msg/CompressedImage"
    CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
    ODOMETRY = "nav_msgs/msg/Odometry"
    IMU = "sensor_msgs/msg/Imu"
    TEXT = "std_msgs/msg/String"
    POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
    POSES = "geometry_msgs/msg/PoseArray"
    PATH = "nav_msgs/msg/Path"
    CLOCK = "rosgraph_msgs/msg/Clock"
    MARKERS = "visualization_msgs/msg/MarkerArray"
    DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
    TRANSFORMS = "tf2_msgs/msg/TFMessage"


Place = tuple[int, int]
"""Where a message stands: its record in the file, or the chunk that holds it, and its number there."""


class BrokenOffError(ValueError):
    """A file that cannot be read to its end, as its recorder did not close it; what came before is as it was."""


class Allowance:
    """How many bytes may still be made of a bag: `MOST_RATIO` times its size on the disk, or `SMALL_BYTES`."""

    def __init__(self, size: int) -> None:
        """Take the size of all files."""
        self.left = most_of(size)

    def spend(self, count: int) -> None:
        """Take some of it. Raises ValueError where less is left."""
        self.left -= count
        if self.left < 0:
            raise ValueError(f"expected a bag that grows at most {MOST_RATIO} times when it is read, found more")

    def unpacked(self, decompressor: Any, data: bytes | memoryview) -> tuple[bytes, bool]:
        """Return what a decompressor makes of `data`, and whether that is all. Raises ValueError when it is too much.

        A few bytes can ask for gigabytes.
        """
        most = min(MAX_CHUNK_BYTES, most_of(len(data)))
        try:
            content: bytes = decompressor.decompress(data, most)
        except Exception as error:  # each library has its own
            raise BrokenOffError("something compressed is damaged") from error
        self.spend(len(content))
        if len(content) >= most and not decompressor.eof:
            raise ValueError(f"expected at most {most} bytes in a chunk, found more")
        return content, bool(decompressor.eof)


def most_of(size: int) -> int:
    """Return how many bytes may be made of something compressed."""
    return max(SMALL_BYTES, MOST_RATIO * size)


class Channel(NamedTuple):
    """A topic and its messages. encoding: cdr or ros1; others are not read."""

    topic: str
    msgtype: str
    encoding: str


class Packed(NamedTuple):
    """A message as it was recorded at a time (ns)."""

    place: Place
    channel: Channel
    t_ns: int
    data: bytes | memoryview


def channel_of(topic: Any, msgtype: Any, encoding: Any) -> Channel:
    """Return a topic; types have the names of ROS 2, and transforms of old bags are transforms. Raises ValueError."""
    if not all(isinstance(text, str) and text.isprintable() for text in (topic, msgtype, encoding)):
        raise ValueError("a topic has no name or no type")
    kind = msgtype.replace("/", "/msg/") if msgtype.count("/") == 1 else msgtype
    return Channel(topic, RosType.TRANSFORMS if kind == "tf/msg/tfMessage" else kind, encoding)


class _Bytes:
    """What records are in: a file, or what a chunk unpacks to."""

    def __init__(self, source: BinaryIO | memoryview) -> None:
        self._source = source
        self.size = len(source) if isinstance(source, memoryview) else source.seek(0, 2)

    def read(self, at: int, count: int) -> bytes | memoryview:
        """Return some bytes, fewer where they end. Raises ValueError for too many."""
        if isinstance(self._source, memoryview):
            return self._source[at : at + count]
        found = max(min(count, self.size - at), 0)
        if found > MAX_CHUNK_BYTES:
            raise too_large(found)
        self._source.seek(at)
        return self._source.read(found)


class Records:
    """The records of an open file."""

    magic: bytes
    CHUNK: int
    MESSAGE: int

    def __init__(self, file: BinaryIO, allowance: Allowance) -> None:
        """Take the file."""
        self.allowance, self._whole = allowance, _Bytes(file)
        self._channels: dict[int, Channel] = {}
        self._types: dict[int, str] = {}
        self._counts: Counter[int] = Counter()
        self._last = -1, _Bytes(memoryview(b"")), True  # the last chunk, as images that were late are asked for again

    def topics(self) -> Counter[tuple[str, str]]:
        """Return name, type and number of messages of topics: by the file's own list, else by reading all of it."""
        with suppress(BrokenOffError, struct.error, LookupError):
            begin = self._list_at()
            for _, kind, content, _ in self._walk(self._whole, begin) if 0 < begin < self._whole.size else ():
                self._define(kind, content)
        found: Counter[tuple[str, str]] = Counter()
        if self._counts:
            for number, channel in self._channels.items():
                found[channel[:2]] += self._counts[number]
        else:
            with suppress(BrokenOffError):  # is reported where the messages are read
                for message in self.messages():
                    found[message.channel[:2]] += 1
        return found

    def messages(self, first: Place = (0, 0)) -> Iterator[Packed]:
        """Yield the messages from a place on, in the order of recording.

        Raises BrokenOffError where the file cannot be read on, ValueError for one that asks for too much.
        """
        try:
            for at, kind, part, is_whole in self._walk(self._whole, max(first[0], len(self.magic))):
                if kind == self.CHUNK and at != self._last[0]:
                    self._last = at, *self._unpacked(part, is_whole)
                inner = self._walk(self._last[1], 0) if kind == self.CHUNK else [(0, kind, part, True)]
                for number, (_, what, content, _) in enumerate(inner):
                    if what != self.MESSAGE:
                        self._define(what, content)
                    elif (at, number) >= first:
                        yield self._message((at, number), content)
                if kind == self.CHUNK and not self._last[2]:
                    raise BrokenOffError("a chunk is cut off")
        except (struct.error, LookupError) as error:
            raise BrokenOffError("a record is damaged") from error

    def _list_at(self) -> int:
        """Return where the list of topics begins that a recorder writes in the end; 0 where there is none."""
        raise NotImplementedError

    def _walk(self, source: _Bytes, at: int) -> Iterator[tuple[int, int, Any, bool]]:
        """Yield place, kind and content of records, and whether that is whole; only that of a chunk may be cut off."""
        raise NotImplementedError

    def _unpacked(self, part: Any, is_whole: bool) -> tuple[_Bytes, bool]:
        """Return what is in a chunk, and whether that is all."""
        raise NotImplementedError

    def _define(self, kind: int, content: Any) -> None:
        """Take what a record says of topics."""
        raise NotImplementedError

    def _message(self, place: Place, content: Any) -> Packed:
        raise NotImplementedError

    def _content(self, squeeze: str, data: memoryview, is_whole: bool) -> tuple[memoryview, bool]:
        from lz4.frame import LZ4FrameDecompressor

        if squeeze in ("", "none"):
            return data, is_whole
        unpackers = {"bz2": BZ2Decompressor, "lz4": LZ4FrameDecompressor, "zstd": zstd().ZstdDecompressor}
        if squeeze not in unpackers:
            raise ValueError(f"expected chunks packed by bz2, lz4 or zstd, found {squeeze!r:.40}")
        content, is_whole = self.allowance.unpacked(unpackers[squeeze](), data)
        return memoryview(content), is_whole

    def _name(self, number: int, channel: Channel) -> None:
        if self._channels.setdefault(number, channel) != channel:
            raise ValueError("two topics share a number, so that their messages cannot be distinguished")
        check_topics(len(self._channels))


class Mcap(Records):
    """An MCAP file (https://mcap.dev/spec)."""

    magic = b"\x89MCAP0\r\n"
    CHUNK, MESSAGE = 6, 5
    _END, _SCHEMA, _CHANNEL, _STATISTICS = (2, 15), 3, 4, 11

    def _list_at(self) -> int:
        end = self._whole.read(max(self._whole.size - 37, 0), 37)
        return int(unpack_from("<Q", end, 9)[0]) if end[0] == self._END[0] and end[-8:] == self.magic else 0

    def _walk(self, source: _Bytes, at: int) -> Iterator[tuple[int, int, Any, bool]]:
        read = (self.CHUNK, self.MESSAGE, self._SCHEMA, self._CHANNEL, self._STATISTICS)
        while at < source.size:
            self.allowance.spend(RECORD_BYTES)
            kind, length = unpack_from("<BQ", source.read(at, 9))
            if kind in self._END:
                return
            is_whole = length <= source.size - at - 9
            if kind in read and (is_whole or kind == self.CHUNK):
                yield at, kind, memoryview(source.read(at + 9, length)), is_whole
            if not is_whole or not kind:
                raise BrokenOffError("a record is cut off")
            at += 9 + length
        if source is self._whole:
            raise BrokenOffError("its recorder did not close it")

    def _unpacked(self, part: memoryview, is_whole: bool) -> tuple[_Bytes, bool]:
        _, _, size, crc = unpack_from("<QQQI", part)
        squeeze, at = _text(part, 28)
        if size > MAX_CHUNK_BYTES:
            raise too_large(size)
        content, is_whole = self._content(squeeze, part[at + 8 :], is_whole)
        if is_whole and crc and crc32(content) != crc:
            raise BrokenOffError("a chunk is damaged: its checksum is another")
        return _Bytes(content), is_whole

    def _define(self, kind: int, content: memoryview) -> None:
        if kind == self._SCHEMA:
            self._types[unpack_from("<H", content)[0]] = _text(content, 2)[0]
            check_topics(len(self._types))
        elif kind == self._CHANNEL:
            number, schema = unpack_from("<HH", content)
            topic, at = _text(content, 4)
            self._name(number, channel_of(topic, self._types.get(schema, ""), _text(content, at)[0]))
        elif kind == self._STATISTICS:
            self._counts.update(dict(iter_unpack("<HQ", content[46 : 46 + unpack_from("<I", content, 42)[0]])))

    def _message(self, place: Place, content: memoryview) -> Packed:
        number, _, t_ns = unpack_from("<HIQ", content)
        return Packed(place, self._channels[number], t_ns, content[22:])


class Ros1(Records):
    """A bag of ROS 1, format 2.0 (http://wiki.ros.org/Bags/Format/2.0)."""

    magic = b"#ROSBAG V2.0\n"
    CHUNK, MESSAGE = 5, 2
    _BAG, _INDEX, _CHUNK_INFO, _CONNECTION = 3, 4, 6, 7

    def _list_at(self) -> int:
        (size,) = unpack_from("<I", self._whole.read(len(self.magic), 4))
        fields = _fields(self._whole.read(len(self.magic) + 4, size))
        if fields.get(b"encryptor"):
            raise ValueError("is encrypted")
        return int(unpack_from("<Q", fields[b"index_pos"])[0])

    def _walk(self, source: _Bytes, at: int) -> Iterator[tuple[int, int, Any, bool]]:
        while at < source.size:
            self.allowance.spend(RECORD_BYTES)
            (size,) = unpack_from("<I", source.read(at, 4))
            head = source.read(at + 4, size + 4)
            fields, begin, (length,) = _fields(head[:size]), at + 8 + size, unpack_from("<I", head, size)
            kind, is_whole = fields[b"op"][0], begin + length <= source.size
            if kind not in (self._BAG, self._INDEX) and (is_whole or kind == self.CHUNK):
                yield at, kind, (fields, memoryview(source.read(begin, length))), is_whole
            if not is_whole:
                raise BrokenOffError("a record is cut off")
            at = begin + length
        if source is self._whole and not 0 < self._list_at() < source.size:
            raise BrokenOffError("its recorder did not close it")

    def _unpacked(self, part: Any, is_whole: bool) -> tuple[_Bytes, bool]:
        content, is_whole = self._content(part[0][b"compression"].decode(), part[1], is_whole)
        return _Bytes(content), is_whole

    def _define(self, kind: int, content: Any) -> None:
        fields, data = content
        if kind == self._CONNECTION:
            (number,) = unpack_from("<I", fields[b"conn"])
            self._name(number, channel_of(fields[b"topic"].decode(), _fields(data)[b"type"].decode(), "ros1"))
        elif kind == self._CHUNK_INFO:
            for number, count in iter_unpack("<II", data):
                self._counts[number] += count

    def _message(self, place: Place, content: Any) -> Packed:
        fields, data = content
        seconds, nanoseconds = unpack_from("<II", fields[b"time"])
        (number,) = unpack_from("<I", fields[b"conn"])
        return Packed(place, self._channels[number], seconds * 10**9 + nanoseconds, data)


def _fields(content: bytes | memoryview) -> dict[bytes, bytes]:
    """Return the fields of a header of ROS 1 by their names."""
    fields, at, header = {}, 0, bytes(content)
    while at < len(header):
        (size,) = unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + size].partition(b"=")
        fields[name] = value
        at += 4 + size
    return fields


def _text(content: memoryview, at: int) -> tuple[str, int]:
    """Return a text of MCAP, and where it ends."""
    (length,) = unpack_from("<I", content, at)
    if at + 4 + length > len(content):
        raise BrokenOffError("a record is damaged")
    return str(content[at + 4 : at + 4 + length], "utf-8"), at + 4 + length


def records_of(file: BinaryIO, allowance: Allowance) -> Records:
    """Return the records of an open file of one of the two kinds, by how it begins. Raises ValueError."""
    head = file.read(16)
    for kind in (Mcap, Ros1):
        if head.startswith(kind.magic):
            return kind(file, allowance)
    others = {b"#ROSBAG": "a bag of an older version of ROS 1", b"version https": "a pointer of Git LFS, not its file"}
    found = next((text for begin, text in others.items() if head.startswith(begin)), "something else")
    raise ValueError(f"expected a bag of ROS 1, MCAP or SQLite, found {found if head else 'an empty file'}")


def too_large(found: int) -> ValueError:
    """Return the error of a chunk that is larger than is allowed."""
    return ValueError(f"expected at most {MAX_CHUNK_BYTES} bytes in a chunk, found {found}")


def check_topics(count: int) -> None:
    """Raise ValueError when a bag has more topics than are handled in a moment."""
    if count > MOST_TOPICS:
        raise ValueError(f"expected at most {MOST_TOPICS} topics, found more")


def zstd() -> Any:
    """Return the module of Python's library that unpacks zstd, or its backport."""
    from rosbags.rosbag2 import storage_mcap

    return vars(storage_mcap)["zstd"]
