"""Image files: whole, of the right size, and decoded to grey."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_log import CAMERA, image

from localiser.errors import InputError, InputWarning
from localiser.storage.images import check_head, encode_image, image_event, measure, read_image, whole_image

SIZE = (CAMERA.width, CAMERA.height)
JPEG = encode_image(image(0), ".jpg", 90)
PNG = encode_image(image(0), ".png", 90)


def colour() -> np.ndarray:
    return np.random.default_rng(3).integers(0, 256, (*image(0).shape, 3), dtype=np.uint8)


def save(folder: Path, data: bytes, name: str = "image.jpg") -> Path:
    (folder / name).write_bytes(data)
    return folder / name


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_colour_becomes_grey_and_the_file_keeps_its_colour(tmp_path: Path, suffix: str) -> None:
    path = save(tmp_path, encode_image(colour(), suffix, 95))
    event = image_event(7, "a", lambda: whole_image(path, SIZE), SIZE, path=path)
    grey = event.load()
    assert grey.shape == (CAMERA.height, CAMERA.width) and grey.dtype == np.uint8
    assert event.encoded() == path.read_bytes()
    expected = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2GRAY)
    assert np.abs(grey.astype(int) - expected).mean() < 1.0


def test_orientation_tag_does_not_turn_the_image(tmp_path: Path) -> None:
    # An EXIF block that says "turn by 90 degrees": the camera's calibration is of the image as it was taken.
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    data = JPEG[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + JPEG[2:]
    with pytest.warns(InputWarning, match="asks to be shown turned by 90°, and is taken as it is stored"):
        turned = read_image(save(tmp_path, data), SIZE)
    np.testing.assert_array_equal(turned, read_image(save(tmp_path, JPEG, "b"), SIZE))
    assert check_head(tmp_path / "image.jpg", SIZE) == 90


def progressive() -> bytes:
    done, data = cv2.imencode(".jpg", image(0), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 2])
    assert done
    return bytes(data)


@pytest.mark.parametrize("data", [JPEG, PNG, progressive()], ids=["jpeg", "png", "progressive"])
def test_size_and_end_are_found_by_structure(data: bytes) -> None:
    assert measure(data) == (SIZE, True)
    assert measure(data + b"what a camera adds") == (SIZE, True)


@pytest.mark.parametrize("data", [JPEG, PNG, progressive()], ids=["jpeg", "png", "progressive"])
def test_every_cut_is_noticed(tmp_path: Path, data: bytes) -> None:
    for end in range(0, len(data) - 1, 7):
        with pytest.raises(InputError, match=r"image\.jpg: expected"):
            read_image(save(tmp_path, data[:end]), SIZE)


@given(place=st.integers(33, len(PNG) - 13), flip=st.integers(1, 255))
@settings(max_examples=50, deadline=None)
def test_one_wrong_byte_of_a_png_is_noticed(place: int, flip: int) -> None:
    data = bytearray(PNG)
    data[place] ^= flip
    assert measure(bytes(data))[1] is False


def test_thumbnail_with_an_end_of_its_own_does_not_hide_a_cut(tmp_path: Path) -> None:
    thumbnail = encode_image(image(1)[:8, :8], ".jpg", 90)
    data = JPEG[:2] + b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail + JPEG[2:]
    assert measure(data) == (SIZE, True)
    assert measure(data[:-40]) == (SIZE, False)


def test_wrong_size_is_refused_before_decoding(tmp_path: Path) -> None:
    path = save(tmp_path, PNG)
    for check in (read_image, check_head):
        with pytest.raises(InputError, match="expected an image of 65×48 pixels, as the camera says, found 64×48"):
            check(path, (65, 48))


def test_head_is_found_behind_a_long_preamble(tmp_path: Path) -> None:
    filler = b"\xff\xe2" + (60_002).to_bytes(2, "big") + bytes(60_000)
    check_head(save(tmp_path, JPEG[:2] + filler * 2 + JPEG[2:]), SIZE)


def test_what_is_no_image(tmp_path: Path) -> None:
    for data, expected in ((b"", "an empty file"), (b"GIF89a", "something else"), (JPEG[:20], "before its size")):
        path = save(tmp_path, data)
        for check in (read_image, check_head):
            with pytest.raises(InputError, match=expected):
                check(path, SIZE)
    with pytest.raises(InputError, match="no such image"):
        check_head(tmp_path / "missing.jpg", SIZE)
