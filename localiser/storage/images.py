"""Read image files (JPEG, PNG), and write them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Mount
from localiser.documents import open_regular, plain_name, read_bytes
from localiser.errors import InputError, warn
from localiser.image_files import PNG_SIGNATURE, decode, measure, turn_deg

Image = NDArray[np.uint8]

MAX_IMAGE_BYTES = 64 * 2**20
_HEAD_BYTES = 2**12
_LONG_HEAD_BYTES = 2**18  # what a camera writes before a JPEG's size: a thumbnail, a colour profile

_PNG_COLOUR_TYPE = 25
_PNG_COLOURS = frozenset((2, 3, 6))


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

    def load() -> Image:
        return decoded(encoded(), size, path=path, field=field)

    return ImageEvent(t_ns, plain_name(name), load, encoded, by_wheels, mount)


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
    data = whole_image(path, size)
    warn_turned(turn_deg(data), path)
    return decoded(data, size, path=path)


def warn_turned(degrees: int, path: Path) -> None:
    """Warn of pictures that ask to be turned when they are shown: they are used as they are stored."""
    if degrees:
        problem = f"asks to be shown turned by {degrees}°, and is taken as it is stored"
        warn(f"{problem}; the camera file must fit the stored image, with its roll", path=path)


def decoded(data: bytes, size: tuple[int, int], *, path: Path, field: str | None = None) -> Image:
    """Return an image file that is known to be whole as (H, W) uint8 grey values. Raises InputError.

    A PNG in colour becomes grey as a raw image does, not by the rounding of OpenCV's reader of PNG.
    """
    colour = data.startswith(PNG_SIGNATURE) and data[_PNG_COLOUR_TYPE] in _PNG_COLOURS
    flags = (cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE) | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = decode(data, flags)
    except ValueError as error:
        raise InputError(str(error), path=path, field=field) from None
    if image is None or image.shape[:2] != (size[1], size[0]):
        raise InputError("expected an image that can be decoded", path=path, field=field)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if colour else image, dtype=np.uint8)


def check_head(path: Path, size: tuple[int, int]) -> int:
    """Check that an image file is there and, by its first bytes alone, that it is an image of `size`.

    Return by how many degrees it asks to be turned. Raises InputError.
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
    return turn_deg(head)


def check_size(path: Path, found: tuple[int, int], size: tuple[int, int], field: str | None = None) -> None:
    """Raise InputError when an image's size is not the camera's."""
    if found != size:
        expected = f"expected an image of {size[0]}×{size[1]} pixels, as the camera says"
        raise InputError(f"{expected}, found {found[0]}×{found[1]}", path=path, field=field)


def suffix_of(data: bytes) -> str:
    """Return what the name of an image file ends with, by its first bytes."""
    return ".png" if data.startswith(PNG_SIGNATURE) else ".jpg"


def encode_image(image: Image, suffix: str, jpeg_quality: int) -> bytes:
    """Return an image, (H, W) grey or (H, W, 3) BGR uint8, as a JPEG or PNG file. Raises ValueError for other types."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3):
        raise ValueError(f"expected an (H, W) or (H, W, 3) image of uint8, found {image.dtype} {image.shape}")
    options = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality] if suffix == ".jpg" else []
    done, data = cv2.imencode(suffix, image, options)
    if not done:
        raise ValueError(f"cannot encode an image as {suffix}")
    return bytes(data)
