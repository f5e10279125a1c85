"""Read image files (JPEG, PNG). They are checked first, because OpenCV decodes half a file without complaint."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from struct import unpack_from
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Mount
from localiser.documents import open_regular, read_bytes
from localiser.errors import InputError

Image = NDArray[np.uint8]

MAX_IMAGE_BYTES = 64 * 2**20
_HEAD_BYTES = 2**12
_LONG_HEAD_BYTES = 2**18  # what a camera writes before a JPEG's size: a thumbnail, a colour profile

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_COLOUR_TYPE = 25
_PNG_COLOURS = frozenset((2, 3, 6))
_JPEG_SIGNATURE = b"\xff\xd8\xff"
_JPEG_END = 0xD9
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")  # not a stuffed byte, a filler or a restart


@dataclass(frozen=True, slots=True, eq=False)
class ImageEvent:
    """An image that was taken at a time; read from disk when it is asked for.

    load: returns the image as (H, W) uint8 grey values. encoded: returns the file as it is (JPEG or PNG), in colour if
    it has any, for the view. Both raise InputError when the file is not an image of the size that the camera has.
    by_wheels: False where a live run did without the wheels, because they were silent. mount: of the camera when it
    took this image, None: as the camera says.
    """

    t_ns: int
    name: str
    load: Callable[[], Image]
    encoded: Callable[[], bytes]
    by_wheels: bool = True
    mount: Mount | None = None


def image_event(
    t_ns: int,
    name: str,
    encoded: Callable[[], bytes],
    size: tuple[int, int],
    *,
    path: Path,
    field: str | None = None,
    by_wheels: bool = True,
    mount: Mount | None = None,
) -> ImageEvent:
    """Return the event of an image file of `size` (width, height), which is decoded when it is asked for.

    path, field: where the image is from, for errors. by_wheels, mount: see there.
    """
    return ImageEvent(t_ns, name, lambda: decoded(encoded(), size, path=path, field=field), encoded, by_wheels, mount)


def whole_image(path: Path, size: tuple[int, int]) -> bytes:
    """Return what an image file holds, after checking that it is whole and of `size` (width, height).

    Raises InputError.
    """
    data = read_bytes(path, MAX_IMAGE_BYTES)
    check_whole(data, size, path=path)
    return data


def check_whole(data: bytes, size: tuple[int, int], *, path: Path, field: str | None = None) -> None:
    """Raise InputError unless `data` is an image file that is whole and of `size`; path, field: where it is from."""
    try:
        found, complete = measure(data)
    except ValueError as error:
        raise InputError(str(error), path=path, field=field) from None
    check_size(path, found, size, field)
    if not complete:
        raise InputError("expected a whole image, found one that is cut off or damaged", path=path, field=field)


def read_image(path: Path, size: tuple[int, int]) -> Image:
    """Return an image file as (H, W) uint8 grey values. Raises InputError."""
    return decoded(whole_image(path, size), size, path=path)


def decoded(data: bytes, size: tuple[int, int], *, path: Path, field: str | None = None) -> Image:
    """Return an image file that is known to be whole as (H, W) uint8 grey values. Raises InputError.

    A PNG in colour becomes grey as a raw image does, not by the rounding of OpenCV's reader of PNG.
    """
    colour = data.startswith(_PNG_SIGNATURE) and data[_PNG_COLOUR_TYPE] in _PNG_COLOURS
    flags = (cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE) | cv2.IMREAD_IGNORE_ORIENTATION
    image = decode_pixels(data, flags)
    if image is None or image.shape[:2] != (size[1], size[0]):
        raise InputError("expected an image that can be decoded", path=path, field=field)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if colour else image, dtype=np.uint8)


def decode_pixels(data: bytes, flags: int) -> NDArray[Any] | None:
    """Return what OpenCV reads from an image file, None where it cannot."""
    try:
        return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error:
        return None


def check_head(path: Path, size: tuple[int, int]) -> None:
    """Check that an image file is there and, by its first bytes alone, that it is an image of `size`.

    Raises InputError.
    """
    with open_regular(path, "image") as file:
        head = file.read(_HEAD_BYTES)
        try:
            try:
                found, _ = measure(head)
            except ValueError:
                found, _ = measure(head + file.read(_LONG_HEAD_BYTES))
        except ValueError as error:
            raise InputError(str(error), path=path) from None
    check_size(path, found, size)


def check_size(path: Path, found: tuple[int, int], size: tuple[int, int], field: str | None = None) -> None:
    """Raise InputError when an image's size is not the camera's."""
    if found != size:
        expected = f"expected an image of {size[0]}×{size[1]} pixels, as the camera says"
        raise InputError(f"{expected}, found {found[0]}×{found[1]}", path=path, field=field)


# -- the structure of the two formats ---------------------------------------------------------------------------------


def measure(data: bytes) -> tuple[tuple[int, int], bool]:
    """Return the size (width, height) that an image file states, and whether the file goes on to its end.

    Raises ValueError when it is neither JPEG nor PNG or ends before the size.
    """
    if data.startswith(_JPEG_SIGNATURE):
        return _measure_jpeg(data)
    if data.startswith(_PNG_SIGNATURE):
        return _measure_png(data)
    raise ValueError("expected a JPEG or PNG image, found " + ("an empty file" if not data else "something else"))


def _measure_jpeg(data: bytes) -> tuple[tuple[int, int], bool]:
    """Walk from marker to marker; compressed data, which follows a scan's header, ends at the next marker."""
    size = None
    place = 2
    while marker := _JPEG_MARKER.search(data, place):
        kind = data[marker.end() - 1]
        if kind == _JPEG_END:
            break
        start = marker.end()
        length = int.from_bytes(data[start : start + 2], "big")
        if kind in _JPEG_FRAMES and start + 7 <= len(data):
            height, width = unpack_from(">HH", data, start + 3)
            size = (width, height)
        place = start + max(length, 2)
    if size is None:
        raise ValueError("expected a JPEG image, found one that is cut off before its size")
    return size, marker is not None


def _measure_png(data: bytes) -> tuple[tuple[int, int], bool]:
    """Walk from chunk to chunk, each of which carries a checksum, to the chunk that ends the file."""
    if len(data) < 33 or data[12:16] != b"IHDR":
        raise ValueError("expected a PNG image, found one that is cut off before its size")
    width, height = unpack_from(">II", data, 16)
    size = (width, height)
    place = len(_PNG_SIGNATURE)
    while place + 12 <= len(data):
        body_end = place + 8 + int.from_bytes(data[place : place + 4], "big")
        checksum = int.from_bytes(data[body_end : body_end + 4], "big")
        if body_end + 4 > len(data) or zlib.crc32(data[place + 4 : body_end]) != checksum:
            return size, False
        if data[place + 4 : place + 8] == b"IEND":
            return size, True
        place = body_end + 4
    return size, False


def suffix_of(data: bytes) -> str:
    """Return what the name of an image file ends with, by its first bytes."""
    return ".png" if data.startswith(_PNG_SIGNATURE) else ".jpg"


def encode_image(image: Image, suffix: str, jpeg_quality: int) -> bytes:
    """Return an image, (H, W) grey or (H, W, 3) BGR uint8, as a JPEG or PNG file. Raises ValueError for other types."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3):
        raise ValueError(f"expected an (H, W) or (H, W, 3) image of uint8, found {image.dtype} {image.shape}")
    options = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality] if suffix == ".jpg" else []
    done, data = cv2.imencode(suffix, image, options)
    if not done:
        raise ValueError(f"cannot encode an image as {suffix}")
    return bytes(data)
