"""Video files with odometry beside them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from short_log import Localiser

from localiser.errors import InputError, InputWarning
from localiser.storage import ImageEvent, open_log
from localiser.storage.video import read_video

WIDTH, HEIGHT, FRAMES = 64, 48, 12
CAMERA = (
    f"image_width: {WIDTH}\nimage_height: {HEIGHT}\n"
    "camera_matrix: {rows: 3, cols: 3, data: [50, 0, 31, 0, 50, 23, 0, 0, 1]}\nmount: {tilt_deg: 20, height_m: 1}\n"
)
ODOMETRY = "t_ns,x,z,heading\n5000000000,0,0,0\n7000000000,0,-1,0\n"


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Return a folder with a video at 10 Hz whose frame k has the grey value 20 k."""
    (tmp_path / "camera.yaml").write_text(CAMERA)
    (tmp_path / "odometry.csv").write_text(ODOMETRY)
    writer = cv2.VideoWriter(str(tmp_path / "drive.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for index in range(FRAMES):
        writer.write(np.full((HEIGHT, WIDTH, 3), 20 * index, dtype=np.uint8))
    writer.release()
    return tmp_path


def grey(frame: object) -> float:
    assert isinstance(frame, ImageEvent)
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
        assert isinstance(mine, ImageEvent) and isinstance(theirs, ImageEvent)
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
        ("camera.yaml", CAMERA.replace("48", "50").encode(), "expected an image of 64×50 pixels, .*found 64×48"),
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
