"""Image files that ask for far more memory or time than their pixels: from files, bags, plans, videos and messages."""

import zlib
from pathlib import Path

import attack_bombs as bombs
import cv2
import numpy as np
import pytest
from bounded import bounded
from small_bag import Recorder, bag
from small_log import image

from localiser.image_files import MOST_SCANS, decode
from localiser.storage.images import encode_image

SIZE, LARGE = (640, 480), (4096, 3000)
BLACK = bombs.black(SIZE)
PNG = encode_image(image(0), ".png", 90)


def read(folder: Path, *files: bytes, size: tuple[int, int] = SIZE) -> list[str]:
    """Return what comes of reading image files within the limits: the mean of their pixels, or an error."""
    for number, data in enumerate(files):
        (folder / str(number)).write_bytes(data)
    code = """
import sys
from pathlib import Path
from localiser.errors import InputError
from localiser.storage import read_image
begin()
for number in range(int(sys.argv[4])):
    try:
        print("mean", read_image(Path(sys.argv[1], str(number)), (int(sys.argv[2]), int(sys.argv[3]))).mean())
    except InputError as error:
        print(error)
"""
    return bounded(code, folder, *size, len(files)).splitlines()


def test_texts_of_a_png_are_not_unpacked(tmp_path: Path) -> None:
    files = [bombs.png_of_texts(BLACK, 300, kind) for kind in (b"zTXt", b"iTXt", b"iCCP")]
    assert read(tmp_path, *files) == ["mean 0.0"] * 3


def test_pixels_beyond_the_last_row_are_not_unpacked(tmp_path: Path) -> None:
    many, few = read(tmp_path, bombs.png_of_more(SIZE, 4000), bombs.png_of_more(SIZE, 1))
    assert "found more pixels in it than it states" in many and few == "mean 0.0", "such encoders exist"


def test_chunks_are_counted(tmp_path: Path) -> None:
    data = PNG[:33] + 5_000_000 * bombs.chunk(b"teXt", b"") + PNG[33:]
    assert "at most 100000 chunks" in read(tmp_path, data)[0]


@pytest.mark.parametrize("marker", [b"", b"\xff\x01\xff\xff"], ids=["plain", "hidden"])
def test_scans_are_counted(tmp_path: Path, marker: bytes) -> None:
    """hidden: behind a marker that has no length, and looks as if it had one that covers the scans."""
    assert "at most 100 scans" in read(tmp_path, bombs.jpeg_of_scans(LARGE, 1000, marker), size=LARGE)[0]
    assert read(tmp_path, bombs.jpeg_of_scans(SIZE, MOST_SCANS, marker)) == ["mean 128.0"]


def test_segments_are_counted(tmp_path: Path) -> None:
    data = bombs.jpeg_of_scans(SIZE, 3, 12_000_000 * b"\xff\xfe\0\2")
    assert "100000 segments, found more" in read(tmp_path, data)[0]


def test_the_size_of_a_jpeg_is_the_first_that_it_states(tmp_path: Path) -> None:
    """Memory is taken for that one."""
    assert "found 30000×20000" in read(tmp_path, bombs.jpeg_of_scans(SIZE, 2, first=(30_000, 20_000)))[0]


def test_pixels_are_counted_where_no_size_is_known() -> None:
    with pytest.raises(ValueError, match="at most 33554432 pixels, found 8192×8192"):
        decode(bombs.black((8192, 8192)), cv2.IMREAD_GRAYSCALE)


@pytest.mark.parametrize("suffix", [".bmp", ".tiff", ".webp", ".ppm", ".jp2", ".hdr", ".gif", ".avif"])
def test_other_formats_are_refused(suffix: str) -> None:
    pixels = np.zeros((64, 64, 3), np.float32 if suffix == ".hdr" else np.uint8)
    done, data = cv2.imencode(suffix, pixels)
    assert done
    with pytest.raises(ValueError, match="expected a JPEG or PNG image, found something else"):
        decode(bytes(data), cv2.IMREAD_COLOR)


def test_what_makes_the_picture_is_decoded() -> None:
    """Palette and transparency count, an animation and what is told beside the pixels do not."""
    rng = np.random.default_rng(1)
    pixels = rng.integers(0, 256, (48, 64, 4), dtype=np.uint8)
    plain = bytes(cv2.imencode(".png", pixels)[1])
    beside = [(b"gAMA", b"\0\0\1\0"), (b"eXIf", b"MM\0*\0\0\0\x08\0\0"), (b"acTL", b"\0\0\0\2\0\0\0\0")]
    data = plain[:33] + b"".join(bombs.chunk(*each) for each in beside) + plain[33:]
    np.testing.assert_array_equal(decode(data, cv2.IMREAD_UNCHANGED), pixels)
    head = bombs.SIGNATURE + bombs.chunk(b"IHDR", b"\0\0\0\2\0\0\0\1\x08\3\0\0\0")
    palette = bombs.chunk(b"PLTE", bytes((1, 2, 3, 4, 5, 6))) + bombs.chunk(b"tRNS", bytes((7, 8)))
    rows = bombs.chunk(b"IDAT", zlib.compress(b"\0\1\0")) + bombs.chunk(b"IEND", b"")
    found = decode(head + palette + rows, cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(found, [[[6, 5, 4, 8], [3, 2, 1, 7]]])


def test_images_of_a_bag_are_bounded(tmp_path: Path) -> None:
    files = {"texts": bombs.png_of_texts(bombs.black((8, 6)), 300), "scans": bombs.jpeg_of_scans((8, 6), 200)}
    for name, data in files.items():
        bag(tmp_path / name, lambda to, data=data: write_two(to, data))  # type: ignore[misc]
    code = """
import sys
from pathlib import Path
from localiser.errors import InputError
from localiser.storage import open_log
begin()
print([frame.load().mean() for frame in open_log(Path(sys.argv[1])).frames])
try:
    open_log(Path(sys.argv[2]))
except InputError as error:
    print(error)
"""
    said = bounded(code, tmp_path / "texts", tmp_path / "scans")
    assert "(0.0), " in said and "at most 100 scans" in said


def write_two(to: Recorder, data: bytes) -> None:
    to.compressed(10**8, data)
    to.compressed(2 * 10**8, encode_image(np.full((6, 8), 50, np.uint8), ".png", 90))


def test_the_picture_of_a_plan_is_bounded(tmp_path: Path) -> None:
    (tmp_path / "hall.png").write_bytes(bombs.png_of_texts(BLACK, 300))
    head = "image: hall.png\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "hall.yaml").write_text(head)
    code = """
import sys
from pathlib import Path
from localiser.storage import read_plan
begin()
print(read_plan(Path(sys.argv[1])).occupied.all())
"""
    assert bounded(code, tmp_path / "hall.yaml") == "True\n"


@pytest.mark.parametrize(
    ("codec", "frame", "size", "expected"),
    [
        (b"MPNG", bombs.png_of_texts(BLACK, 300), SIZE, "found PNG"),
        (b"MJPG", bombs.jpeg_of_scans(LARGE, 1000), LARGE, "frame 7: expected a JPEG of at most 100 scans"),
    ],
)
def test_frames_of_a_video_are_bounded(tmp_path, codec, frame, size, expected):
    plain = bombs.black(size) if codec == b"MPNG" else bombs.jpeg_of_scans(size, 2)
    (tmp_path / "drive.avi").write_bytes(bombs.movie([plain] * 7 + [frame] * 13, size, codec))
    (tmp_path / "camera.yaml").write_text(
        f"image_width: {size[0]}\nimage_height: {size[1]}\n"
        "camera_matrix: {rows: 3, cols: 3, data: [500, 0, 300, 0, 500, 200, 0, 0, 1]}\n"
        "mount: {tilt_deg: 20, height_m: 1}\n"
    )
    code = """
import sys
from pathlib import Path
from localiser.errors import InputError
from localiser.storage import read_video
begin()
try:
    read_video(Path(sys.argv[1]), None, Path(sys.argv[2]))
except InputError as error:
    print(error)
"""
    assert expected in bounded(code, tmp_path / "drive.avi", tmp_path / "camera.yaml")
