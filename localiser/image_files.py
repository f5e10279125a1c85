"""JPEG and PNG files: their structure, and the one place where they are decoded.

They are checked first, because OpenCV decodes half a file without complaint, and some small ones for minutes.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from contextlib import suppress
from struct import error, unpack_from
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_PICTURE = frozenset((b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"))
_PNG_DEPTH = 24  # the byte that says how many bits a value has
_PNG_RATIO = 1032  # what zlib packs into one byte at most
_QUICK_BYTES = 2**29  # unpacked in a second
_JPEG_SIGNATURE = b"\xff\xd8\xff"
_JPEG_END, _JPEG_SCAN = 0xD9, 0xDA
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_MARKER = re.compile(rb"\xff[^\x00\x01\xff\xd0-\xd7]")  # one with a length: no stuffed byte, filler or restart
_ORIENTATION = 0x112  # of EXIF
MOST_SCANS = 100  # of a JPEG, each of which goes through the whole image; encoders make ten
MOST_PARTS = 100_000  # segments of a JPEG, chunks of a PNG
MOST_PIXELS = 2**25  # as many as a floor plan may have; a camera has fewer


def measure(data: bytes) -> tuple[tuple[int, int], bool]:
    """Return the size (width, height) that an image file states, and whether the file goes on to its end.

    Raises ValueError when it is neither JPEG nor PNG, ends before the size, or has more parts than are allowed.
    """
    if data.startswith(_JPEG_SIGNATURE):
        return _measure_jpeg(data)
    if data.startswith(PNG_SIGNATURE):
        return _measure_png(data)
    raise ValueError("expected a JPEG or PNG image, found " + ("an empty file" if not data else "something else"))


def turn_deg(data: bytes) -> int:
    """Return by how many degrees, clockwise, a JPEG asks to be turned when it is shown (EXIF); mirrored or not."""
    tiff = data[: 2**16].partition(b"Exif\0\0")[2] if data.startswith(_JPEG_SIGNATURE) else b""
    order = ">" if tiff.startswith(b"MM") else "<"
    with suppress(error):
        first = unpack_from(f"{order}I", tiff, 4)[0]
        for entry in range(unpack_from(f"{order}H", tiff, first)[0]):
            tag, _, _, value = unpack_from(f"{order}HHIH", tiff, first + 2 + 12 * entry)
            if tag == _ORIENTATION:
                return {3: 180, 4: 180, 5: 90, 6: 90, 7: 270, 8: 270}.get(value, 0)
    return 0


def decode(data: bytes, flags: int) -> NDArray[Any] | None:
    """Return the pixels that OpenCV reads from a JPEG or PNG file, None where it cannot. flags: of cv2.imdecode.

    Values of 16 bits become 8 by `eight_bits`, unless they are asked for unchanged. Of a PNG OpenCV gets the chunks of
    the picture alone: texts and profiles unpack to any size, and animations are many pictures. Raises ValueError as
    `measure` does, where there are too many pixels, and where a PNG holds more than it states.
    """
    (width, height), _ = measure(data)
    if width * height > MOST_PIXELS:
        raise ValueError(f"expected an image of at most {MOST_PIXELS} pixels, found {width}×{height}")
    if data.startswith(PNG_SIGNATURE):
        chunks = [(name, chunk) for name, chunk in _png_chunks(data) if name in _PNG_PICTURE]
        packed = b"".join(chunk[8:-4] for name, chunk in chunks if name == b"IDAT")
        _check_unpacked(packed, (8 * width + 2) * height + 2**16)  # a pixel has 8 bytes at most, an interlaced row 2
        data = PNG_SIGNATURE + b"".join(chunk for _, chunk in chunks)
    is_deep = (
        data.startswith(PNG_SIGNATURE)
        and data[_PNG_DEPTH : _PNG_DEPTH + 1] == b"\x10"
        and flags != cv2.IMREAD_UNCHANGED
    )
    try:
        found = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags | (cv2.IMREAD_ANYDEPTH if is_deep else 0))
        return eight_bits(found) if is_deep and found is not None else found
    except cv2.error:
        return None


def eight_bits(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """Return whole numbers of 16 bits as 8 bits, by the range that they use: 8, 10, 12, 14 or 16 bits.

    It is the smallest that has the largest of them, as a sensor of 12 bits in 16 leaves the upper four empty.
    """
    used = next(bits for bits in (8, 10, 12, 14, 16) if pixels.max(initial=0) < 2**bits)
    return np.asarray(pixels >> (used - 8), dtype=np.uint8)


def _measure_jpeg(data: bytes) -> tuple[tuple[int, int], bool]:
    """Walk from marker to marker; compressed data, which follows a scan's header, ends at the next marker."""
    size = None
    place, parts, scans = 2, 0, 0
    while marker := _JPEG_MARKER.search(data, place):
        kind = data[marker.end() - 1]
        if kind == _JPEG_END:
            break
        parts, scans = parts + 1, scans + (kind == _JPEG_SCAN)
        if parts > MOST_PARTS or scans > MOST_SCANS:
            raise ValueError(f"expected a JPEG of at most {MOST_SCANS} scans and {MOST_PARTS} segments, found more")
        start = marker.end()
        length = int.from_bytes(data[start : start + 2], "big")
        if kind in _JPEG_FRAMES and size is None and start + 7 <= len(data):  # memory is taken for the first
            height, width = unpack_from(">HH", data, start + 3)
            size = (width, height)
        place = start + max(length, 2)
    if size is None:
        raise ValueError("expected a JPEG image, found one that is cut off before its size")
    return size, marker is not None


def _measure_png(data: bytes) -> tuple[tuple[int, int], bool]:
    if len(data) < 33 or data[12:16] != b"IHDR":
        raise ValueError("expected a PNG image, found one that is cut off before its size")
    width, height = unpack_from(">II", data, 16)
    return (width, height), any(name == b"IEND" for name, _ in _png_chunks(data))


def _png_chunks(data: bytes) -> Iterator[tuple[bytes, memoryview]]:
    """Yield name and bytes of each chunk to the one that ends the file, or to one that is cut off or damaged."""
    view, place = memoryview(data), len(PNG_SIGNATURE)
    for _ in range(MOST_PARTS):
        end = place + 12 + int.from_bytes(view[place : place + 4], "big")
        if end > len(data) or zlib.crc32(view[place + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            return
        name = bytes(view[place + 4 : place + 8])
        yield name, view[place:end]
        if name == b"IEND":
            return
        place = end
    raise ValueError(f"expected a PNG of at most {MOST_PARTS} chunks, found more")


def _check_unpacked(packed: bytes, most: int) -> None:
    """Raise ValueError when compressed pixels come to more than `most` bytes, and that would take long to find out."""
    if _PNG_RATIO * len(packed) <= _QUICK_BYTES:
        return
    unpacker, left, step = zlib.decompressobj(), most, 2**16
    with suppress(zlib.error):  # where OpenCV ends, too
        for place in range(0, len(packed), step):
            left -= len(unpacker.decompress(packed[place : place + step], left + 1))
            if left < 0:
                raise ValueError("expected a PNG image, found more pixels in it than it states")
