"""Image files: whole, of the right size, decoded to grey; and video files."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from short_log import Localiser
from small_log import CAMERA, image

from localiser.errors import InputError, InputWarning
from localiser.storage import open_log
from localiser.storage.images import check_head, encode_image, image_event, measure, read_image, whole_image
from localiser.storage.video import read_video

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


WIDTH, HEIGHT, FRAMES = 64, 48, 12
CAMERA_TEXT = (
    f"image_width: {WIDTH}\nimage_height: {HEIGHT}\n"
    "camera_matrix: {rows: 3, cols: 3, data: [50, 0, 31, 0, 50, 23, 0, 0, 1]}\nmount: {tilt_deg: 20, height_m: 1}\n"
)
ODOMETRY = "t_ns,x,z,heading\n5000000000,0,0,0\n7000000000,0,-1,0\n"


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Return a folder with a video at 10 Hz whose frame k has the grey value 20 k."""
    (tmp_path / "camera.yaml").write_text(CAMERA_TEXT)
    (tmp_path / "odometry.csv").write_text(ODOMETRY)
    writer = cv2.VideoWriter(str(tmp_path / "drive.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for index in range(FRAMES):
        writer.write(np.full((HEIGHT, WIDTH, 3), 20 * index, dtype=np.uint8))
    writer.release()
    return tmp_path


def grey(frame: object) -> float:
    image = frame.load()
    assert image.shape == (HEIGHT, WIDTH)
    return float(image.mean())


def read(drive: Path, start_ns: int | None = None) -> object:
    return read_video(drive / "drive.avi", drive / "odometry.csv", drive / "camera.yaml", start_ns)


def test_frames_have_their_times_and_their_images_in_any_order(drive: Path) -> None:
    log = read_video(drive / "drive.avi", drive / "odometry.csv", drive / "camera.yaml")
    assert [frame.t_ns for frame in log.frames] == [5 * 10**9 + index * 10**8 for index in range(FRAMES)]
    for index in (*range(FRAMES), 3, 9, 0, 0):
        assert grey(log.frames[index]) == pytest.approx(20 * index, abs=3)


def test_the_clock_of_the_video_is_set_by_its_start(drive: Path) -> None:
    log = read_video(drive / "drive.avi", drive / "odometry.csv", drive / "camera.yaml", 6 * 10**9)
    assert log.frames[0].t_ns == 6 * 10**9
    with pytest.raises(InputError, match="expected odometry during the images"):
        read(drive, 9 * 10**9)


def test_a_video_becomes_a_log_folder(drive: Path, localiser: Localiser) -> None:
    options = ("--odometry", drive / "odometry.csv", "--camera", drive / "camera.yaml", "--quiet")
    result = localiser("convert", drive / "drive.avi", drive / "log", *options)
    assert (result.exit_code, result.err) == (0, "")
    log = open_log(drive / "log")
    video = read_video(drive / "drive.avi", drive / "odometry.csv", drive / "camera.yaml")
    assert log.name == "log" and {path.suffix for path in (drive / "log" / "images").iterdir()} == {".jpg"}
    for mine, theirs in zip(log.frames, video.frames, strict=True):
        np.testing.assert_array_equal(mine.load(), theirs.load())


def test_a_video_needs_no_odometry(drive: Path, localiser: Localiser) -> None:
    options = ("--camera", drive / "camera.yaml", "--quiet")
    assert localiser("convert", drive / "drive.avi", drive / "log", *options).exit_code == 0
    log = open_log(drive / "log")
    assert len(log.odometry) == 0 and log.settings == {"increments.source": "vision"}
    assert (log.start_ns, log.duration_s) == (0, pytest.approx((FRAMES - 1) / 10))
    assert not (drive / "log" / "odometry.csv").exists()
    for command in (
        ("convert", drive / "log", drive / "log.mcap"),
        ("map", "build", drive / "log", "--poses", "slam", "-o", drive / "map.yaml"),
        ("camera", "tilt", drive / "log"),
    ):
        result = localiser(*command)
        assert result.exit_code == 2 and "odometry" in result.err and "Traceback" not in result.err, command


def test_what_is_for_videos_alone_is_refused(drive: Path, localiser: Localiser) -> None:
    options = ("--odometry", drive / "odometry.csv", "--camera", drive / "camera.yaml", "--quiet")
    assert localiser("convert", drive / "drive.avi", drive / "log", *options).exit_code == 0
    result = localiser("convert", drive / "drive.avi", drive / "other", "--odometry", drive / "odometry.csv")
    assert result.exit_code == 2 and "--camera: missing: a video needs --camera FILE" in result.err
    result = localiser("convert", drive / "log", drive / "other", "--start-ns", 5)
    assert result.exit_code == 2 and "--start-ns: is for a video" in result.err


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("drive.avi", b"", "drive.avi: expected a video that can be decoded"),
        ("drive.avi", b"#EXTM3U\nhttp://x/y\n", "drive.avi: expected a video that can be decoded"),
        ("camera.yaml", CAMERA_TEXT.replace("48", "50").encode(), "expected an image of 64×50 pixels, .*found 64×48"),
        ("odometry.csv", b"t_ns,x,z,heading\n", "expected at least 1 rows"),
    ],
)
def test_what_cannot_be_read_is_named(drive: Path, name: str, content: bytes, problem: str) -> None:
    (drive / name).write_bytes(content)
    with pytest.raises(InputError, match=problem):
        read(drive)


def test_damaged_videos_are_read_or_refused(drive: Path) -> None:
    whole = (drive / "drive.avi").read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(60):
        content = bytearray(whole[: rng.integers(len(whole))] if rng.random() < 0.3 else whole)
        for place in rng.integers(0, max(len(content), 1), 3):
            if content:
                content[place] = rng.integers(256)
        (drive / "drive.avi").write_bytes(content)
        try:
            log = read_video(drive / "drive.avi", drive / "odometry.csv", drive / "camera.yaml")
            for frame in log.frames:
                grey(frame)
        except InputError as error:
            assert len(str(error)) < 1000


def test_a_video_that_asks_to_be_turned_is_taken_as_it_is_stored(drive: Path) -> None:
    # What OpenCV writes, with half a turn put into the matrix of the track's header (tkhd).
    writer = cv2.VideoWriter(str(drive / "drive.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 10.0, (WIDTH, HEIGHT))
    half = np.repeat([[[20], [220]]], HEIGHT, axis=0).repeat(WIDTH // 2, axis=1)
    for _ in range(FRAMES):
        writer.write(np.repeat(half.reshape(HEIGHT, WIDTH, 1), 3, axis=2).astype(np.uint8))
    writer.release()
    file = drive / "drive.mp4"
    content, one = file.read_bytes(), (1 << 16).to_bytes(4, "big")
    place = content.index(b"tkhd") + 44
    assert content[place : place + 4] == content[place + 16 : place + 20] == one
    minus = (-(1 << 16) % 2**32).to_bytes(4, "big")
    file.write_bytes(content[:place] + minus + content[place + 4 : place + 16] + minus + content[place + 20 :])
    with pytest.warns(InputWarning, match="shown turned by 180°"):
        log = read_video(file, drive / "odometry.csv", drive / "camera.yaml")
    image = log.images[0].load()
    assert image[:, : WIDTH // 2].mean() < 60 < image[:, WIDTH // 2 :].mean()
