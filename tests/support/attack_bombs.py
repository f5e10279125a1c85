"""Small inputs that ask for much memory or time: pictures whose parts unpack to gigabytes, robots of many frames."""

import struct
import zlib
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

SIGNATURE = b"\x89PNG\r\n\x1a\n"
Size = tuple[int, int]
TEXT_BYTES = 7_900_000  # libpng leaves out a text that is longer than 8 MB, and takes a thousand


def chunk(name: bytes, body: bytes) -> bytes:
    """Return a chunk of a PNG with a right checksum."""
    return len(body).to_bytes(4, "big") + name + body + zlib.crc32(name + body).to_bytes(4, "big")


def zeros(megabytes: int) -> bytes:
    """Return many zero bytes, packed to a thousandth."""
    packer = zlib.compressobj(9, wbits=-15)
    block = packer.compress(bytes(2**20)) + packer.flush(zlib.Z_FULL_FLUSH)
    checksum = (megabytes * 2**20 % 65521 << 16) + 1
    return b"\x78\xda" + megabytes * block + b"\3\0" + checksum.to_bytes(4, "big")


def png_of_texts(png: bytes, count: int, kind: bytes = b"zTXt") -> bytes:
    """Return a PNG with packed texts behind its head; kind: zTXt, iTXt, or iCCP for colour profiles."""
    head = {b"zTXt": b"a\0\0", b"iTXt": b"a\0\1\0\0\0", b"iCCP": b"a\0\0"}[kind]
    return png[:33] + count * chunk(kind, head + zlib.compress(TEXT_BYTES * b"a", 9)) + png[33:]


def png_of_more(size: Size, megabytes: int) -> bytes:
    """Return a black PNG of a size (width, height), whose pixels go on far behind the last row."""
    head = struct.pack(">IIBBBBB", *size, 8, 0, 0, 0, 0)
    return SIGNATURE + chunk(b"IHDR", head) + chunk(b"IDAT", zeros(megabytes)) + chunk(b"IEND", b"")


def jpeg_of_scans(size: Size, scans: int, before: bytes = b"", first: Size | None = None) -> bytes:
    """Return a grey progressive JPEG of a size (width, height) with so many scans, of a bit a block or less.

    before: put before the scans. first: a size that an earlier head of the image states.
    """

    def segment(kind: int, body: bytes) -> bytes:
        return bytes((0xFF, kind)) + struct.pack(">H", len(body) + 2) + body

    def frame(of: Size) -> bytes:
        return segment(0xC2, struct.pack(">BHHB", 8, of[1], of[0], 1) + b"\1\x11\0")

    blocks = -(-size[0] // 8) * -(-size[1] // 8)
    runs = bytes(2 * (blocks // 2**14 + 1))  # a code of one bit, and fourteen that say how many blocks to go on
    tables = segment(0xDB, b"\0" + bytes([16] * 64))
    for place, code in ((0x00, 0x00), (0x10, 0xE0)):
        tables += segment(0xC4, bytes([place, 1, *([0] * 15), code]))
    mean = segment(0xDA, b"\1\1\0\0\0\0") + bytes(blocks // 8 + 1)
    rest = segment(0xDA, b"\1\1\0\1\x3f\1") + runs
    refined = segment(0xDA, b"\1\1\0\1\x3f\x10") + runs
    if first is not None:
        return b"\xff\xd8" + tables + frame(first) + mean + frame(size) + rest + b"\xff\xd9"
    return b"\xff\xd8" + tables + frame(size) + before + mean + rest + (scans - 2) * refined + b"\xff\xd9"


def many_frames(make: Any, count: int, first: int = 0, t_ns: int = 0) -> bytes:
    """Return a message of transforms in one row from the robot on. make: of `storage.bags.Messages`.

    first: number of the first frame.
    """
    names = ["base_link", *(f"frame_{number}" for number in range(first, first + count))]
    return transforms(make, pairwise(names), t_ns)


def transforms(make: Any, links: Iterable[tuple[str, str]], t_ns: int = 0) -> bytes:
    """Return a message of transforms that move nothing between frames, by the names of parent and child."""
    seconds, nanoseconds = divmod(t_ns, 10**9)
    header = make.make("std_msgs/msg/Header", stamp={"sec": seconds, "nanosec": nanoseconds})
    still = make.make("geometry_msgs/msg/TransformStamped", header=header, transform={"rotation": {"w": 1.0}})
    stamped = [replace(still, header=replace(header, frame_id=parent), child_frame_id=child) for parent, child in links]
    return bytes(make.encode(make.make("tf2_msgs/msg/TFMessage", transforms=stamped)))


def movie(frames: list[bytes], size: Size, codec: bytes) -> bytes:
    """Return an AVI file of frames that are files of their own, 10 a second. codec: MJPG or MPNG."""

    def part(name: bytes, body: bytes) -> bytes:
        return name + struct.pack("<I", len(body)) + body + bytes(len(body) % 2)

    longest = max(map(len, frames))
    head = struct.pack("<14I", 100_000, 0, 0, 16, len(frames), 0, 1, longest, *size, 0, 0, 0, 0)
    stream = b"vids" + codec + struct.pack("<12I", 0, 0, 0, 1, 10, 0, len(frames), longest, 2**32 - 1, 0, 0, 0)
    form = struct.pack("<IiiHH4s5I", 40, *size, 1, 24, codec, 0, 0, 0, 0, 0)
    streams = part(b"LIST", b"strl" + part(b"strh", stream) + part(b"strf", form))
    index, at = [], 4
    for frame in frames:
        index.append(b"00dc" + struct.pack("<III", 16, at, len(frame)))
        at += 8 + len(frame) + len(frame) % 2
    lists = part(b"LIST", b"hdrl" + part(b"avih", head) + streams)
    lists += part(b"LIST", b"movi" + b"".join(part(b"00dc", frame) for frame in frames))
    return part(b"RIFF", b"AVI " + lists + part(b"idx1", b"".join(index)))


def black(size: Size) -> bytes:
    """Return a black PNG of a size (width, height)."""
    head = struct.pack(">IIBBBBB", *size, 8, 0, 0, 0, 0)
    rows = np.zeros((size[1], size[0] + 1), np.uint8).tobytes()
    return SIGNATURE + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
