"""The log folder: written whole or not at all, read back, refused with the place of what is wrong; other formats."""

import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_log import CAMERA, IMAGE_TIMES, MAP, ODOMETRY, START, TRUTH, image, write_edge_log, write_small_log

from localiser.camera import Mount, MountSigma
from localiser.errors import InputError, InputWarning, OutputError
from localiser.filter import mcl
from localiser.storage import (
    FORMATS,
    FolderReader,
    Image,
    ImageEvent,
    Log,
    LogReader,
    ReadOptions,
    open_log,
    require_new,
    require_new_file,
    write_bytes,
    write_log,
)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_log(tmp_path_factory.mktemp("logs") / "small", suffix=".png")


@pytest.fixture
def log_folder(written: Path, tmp_path: Path) -> Path:
    shutil.copytree(written, tmp_path / "small")
    return tmp_path / "small"


def test_log_is_read_back(written: Path) -> None:
    log = open_log(written)
    assert (log.name, log.has_images, log.duration_s, log.camera.width) == ("small", True, 0.2, CAMERA.width)
    assert log.landmark_map is not None and log.landmark_map.ids == MAP.ids
    np.testing.assert_allclose(log.odometry.poses, ODOMETRY.poses, atol=1e-9)
    np.testing.assert_allclose(log.groundtruth.poses, TRUTH.poses, atol=1e-9)
    np.testing.assert_allclose(log.start.mean, START.mean)
    np.testing.assert_allclose(log.start.cov, START.cov, atol=1e-15)
    assert log.start.t_ns == 0


def test_events_come_in_the_order_of_time_start_first_and_odometry_before_images(written: Path) -> None:
    log = open_log(written)
    events = list(log.events())
    assert isinstance(events[0], mcl.Start)
    kinds = [(event.t_ns // 10**6, type(event).__name__) for event in events[1:]]
    assert kinds == [
        (0, "Odometry"),
        (0, "ImageEvent"),
        (50, "Odometry"),
        (100, "Odometry"),
        (100, "ImageEvent"),
        (150, "Odometry"),
        (170, "ImageEvent"),
        (200, "Odometry"),
    ]
    other = replace(START, mean=np.zeros(3))
    assert next(iter(log.events(other))) is other


def test_images_are_loaded_when_they_are_asked_for(log_folder: Path) -> None:
    log = open_log(log_folder)
    frames = [frame for frame in log.frames if isinstance(frame, ImageEvent)]
    np.testing.assert_array_equal(frames[2].load(), image(2))
    (log_folder / "images/000002.png").write_bytes((log_folder / "images/000002.png").read_bytes()[:-9])
    with pytest.raises(InputError, match=r"000002\.png: expected a whole image, found one that is cut off"):
        frames[2].load()


def test_log_of_edges_runs_without_images(tmp_path: Path) -> None:
    log = open_log(write_edge_log(tmp_path / "edges"))
    assert not log.has_images
    sighted = [event for event in log.events() if isinstance(event, mcl.Sighting)]
    assert [(event.t_ns, len(event.edges)) for event in sighted] == list(zip(IMAGE_TIMES, (2, 0, 2), strict=True))


def edit(name: str, before: str, after: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        content = (folder / name).read_text()
        assert before in content
        (folder / name).write_text(content.replace(before, after))

    return change


def remove(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def link_outside(folder: Path) -> None:
    outside = folder.parent / "outside.png"
    shutil.move(folder / "images/000001.png", outside)
    (folder / "images/000001.png").symlink_to(outside)


def keep_header(name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / name).write_text((folder / name).read_text().splitlines()[0] + "\n")

    return change


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (remove("camera.yaml"), "camera.yaml: no such file"),
        (keep_header("images.csv"), "images.csv: expected at least 1 rows after the header, found 0"),
        (keep_header("odometry.csv"), "odometry.csv: expected at least 1 rows"),
        (edit("images.csv", "100000000", "-1"), "images.csv:3: t_ns: expected a time after 0, found -1"),
        (
            edit("odometry.csv", "100000000", "20"),
            "odometry.csv:4: t_ns: expected a time not before 50000000, found 20",
        ),
        (edit("odometry.csv", "-0.1", "nan"), "odometry.csv:3: z: expected a"),
        (remove("images/000001.png"), "images/000001.png: no such image"),
        (edit("camera.yaml", "image_width: 64", "image_width: 65"), "expected an image of 65×48 pixels"),
        (edit("images.csv", "images/000001", "../images/000001"), "images.csv:3: file: expected a path inside"),
        (edit("images.csv", "images/000001", "/etc/000001"), "images.csv:3: file: expected a path inside the log's"),
        (edit("images.csv", "images/000001", "C:/000001"), "images.csv:3: file: expected a path inside the log's"),
        (edit("images.csv", "images/000001.png", " "), "images.csv:3: file: expected a name"),
        (link_outside, "images.csv:3: file: expected a path inside the log's folder, found a link to"),
        (edit("log.yaml", "camera.yaml", "../camera.yaml"), "log.yaml:3:1: camera: expected a path inside the log's"),
        (edit("log.yaml", "odometry:", "odometri:"), "log.yaml:4:1: odometri: unknown key; the nearest known is"),
        (edit("log.yaml", "log/1", "log/9"), "log.yaml:1:1: format: expected 'localiser-log/1'"),
        (edit("log.yaml", "images: images.csv\n", ""), "log.yaml:1:1: images: expected images or edges, found neither"),
        (edit("log.yaml", "images: ", "edges: edges.csv\nimages: "), "edges: expected images or edges, found both"),
        (edit("log.yaml", "sigma_m: 0.1", "sigma_m: -1"), "start.sigma_m: expected greater than or equal to 0"),
        (edit("log.yaml", "name: small", "name: ''"), "log.yaml:2:1: name: string should have at least 1 character"),
        (edit("map.yaml", "id: 8", "id: 7"), "map.yaml:6:4: landmarks[1].id: expected an id of its own"),
    ],
)
def test_what_is_wrong_is_named_when_the_log_is_opened(log_folder, change, expected):
    change(log_folder)
    with pytest.raises(InputError) as caught:
        open_log(log_folder)
    assert str(caught.value).startswith(str(log_folder)) and expected in str(caught.value)


def test_images_and_odometry_must_overlap(log_folder: Path) -> None:
    (log_folder / "images.csv").write_text("t_ns,file\n900000000,images/000000.png\n")
    with pytest.raises(InputError, match="expected odometry during the images, found odometry from 0 to 200000000 ns"):
        open_log(log_folder)


def test_truth_of_another_time_is_told(log_folder: Path) -> None:
    (log_folder / "groundtruth.csv").write_text("t_ns,x,z,heading\n900000000,0,0,0\n")
    with pytest.warns(InputWarning, match="cover none of the images"):
        open_log(log_folder)


# -- writing ----------------------------------------------------------------------------------------------------------


def broken_off(after: int) -> Iterator[tuple[int, Image]]:
    for index in range(after):
        yield index, image(index)
    raise KeyboardInterrupt


def test_writing_that_is_broken_off_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        write_log(tmp_path / "log", name="a", camera=CAMERA, odometry=ODOMETRY, images=broken_off(2))
    assert list(tmp_path.iterdir()) == []


def test_log_needs_images_or_sightings(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected images or sightings"):
        write_log(tmp_path / "log", name="a", camera=CAMERA, odometry=ODOMETRY)


# -- the development data ---------------------------------------------------------------------------------------------


@pytest.mark.data
def test_house_is_read_whole(data_dir: Path) -> None:
    log = open_log(data_dir / "house")
    assert log.name == "A_house"
    assert len(log.frames) == 418 and len(log.odometry) == 1671
    assert log.landmark_map is not None and len(log.landmark_map) == 261
    frame = log.frames[-1]
    assert isinstance(frame, ImageEvent) and frame.load().shape == (480, 640)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
@pytest.mark.parametrize("name", ["images/000000.jpg", "images.csv", "odometry.csv", "camera.yaml", "map.yaml"])
def test_a_pipe_in_place_of_a_file_is_told_and_not_waited_for(tmp_path: Path, name: str) -> None:
    path = write_small_log(tmp_path / "log") / name
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(InputError, match="expected a file, found a device or pipe"):
        open_log(tmp_path / "log")


def with_columns(written: Path, folder: Path, header: str, *rows: str) -> Path:
    """Copy the log, and add columns to its table of images."""
    shutil.copytree(written, folder)
    table = folder / "images.csv"
    lines = [f"{line},{cells}" for line, cells in zip(table.read_text().split(), (header, *rows), strict=True)]
    table.write_text("\n".join(lines) + "\n")
    return folder


def mounts_of(folder: Path) -> list[Mount | None]:
    return [frame.mount for frame in open_log(folder).frames if isinstance(frame, ImageEvent)]


def test_a_log_without_the_columns_has_no_mounts(written: Path) -> None:
    assert mounts_of(written) == [None, None, None]


def test_an_empty_cell_means_what_the_camera_file_says(written: Path, tmp_path: Path) -> None:
    header = "tilt_deg,height_m,tilt_deg_sigma"
    first, second, third = mounts_of(with_columns(written, tmp_path / "log", header, "25,,", ",1.5,0.2", ",,"))
    usual = open_log(written).camera.mount
    assert first == replace(usual, tilt_rad=np.radians(25.0))
    assert second == replace(usual, height_m=1.5, sigma=MountSigma(tilt_rad=np.radians(0.2))) and third is None


def test_mounts_are_read_back_as_they_were_written(tmp_path: Path) -> None:
    sigma = MountSigma(tilt_rad=0.01, yaw_rad=0.02, height_m=0.03)
    moved = Mount(0.3, 1.2, 0.01, -0.4, 0.05, -0.2, sigma=sigma)
    mounts = [None, moved, replace(CAMERA.mount, yaw_rad=1.0)]
    images = [(t_ns, image(index)) for index, t_ns in enumerate(IMAGE_TIMES)]
    write_log(tmp_path / "log", name="a", camera=CAMERA, odometry=ODOMETRY, images=images, mounts=mounts)
    found = mounts_of(tmp_path / "log")
    assert found[0] is None
    for one, other in zip(found[1:], mounts[1:], strict=True):
        assert one is not None and other is not None
        for name in ("tilt_rad", "height_m", "roll_rad", "yaw_rad", "right_m", "back_m"):
            assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-14)
    assert found[1].sigma.yaw_rad == pytest.approx(0.02) and found[1].sigma.roll_rad is None


def test_columns_that_would_say_nothing_are_not_written(tmp_path: Path) -> None:
    images = [(t_ns, image(index)) for index, t_ns in enumerate(IMAGE_TIMES)]
    mounts = [replace(CAMERA.mount, height_m=1.0 + index) for index in range(3)]
    write_log(tmp_path / "log", name="a", camera=CAMERA, odometry=ODOMETRY, images=images, mounts=mounts)
    assert (tmp_path / "log/images.csv").read_text().startswith("t_ns,file,height_m\n")


@pytest.mark.parametrize(
    ("column", "cell", "expected"),
    [
        ("tilt_deg", "90", "above -90 and below 90 degrees"),
        ("roll_deg", "181", "within ±180"),
        ("height_m", "0", "above 0"),
        ("back_m", "-101", "within ±100 m"),
        ("tilt_deg_sigma", "-0.1", "from 0 to 45"),
        ("right_m_sigma", "11", "from 0 to 10 m"),
        ("yaw_deg", "left", "a number"),
    ],
)
def test_a_mount_that_cannot_be_is_refused(written, tmp_path, column, cell, expected):
    folder = with_columns(written, tmp_path / "log", column, "", cell, "")
    with pytest.raises(InputError, match=expected) as error:
        open_log(folder)
    assert error.value.line == 3 and error.value.field == column


class PointerReader:
    """Reads a file that names another log; a format of someone else."""

    format, looks_like, options = "pointer", "a file that ends in .pointer", ("topics",)

    def recognises(self, path: Path) -> bool:
        return path.suffix == ".pointer"

    def read(self, path: Path, options: ReadOptions) -> Log:
        return replace(FolderReader().read(Path(path.read_text()), options), name=options.topics.get("name", "none"))


@pytest.fixture
def pointer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    readers: list[LogReader] = [*FORMATS, PointerReader()]
    monkeypatch.setattr("localiser.storage.open.FORMATS", readers)
    write_edge_log(tmp_path / "log")
    (tmp_path / "a.pointer").write_text(str(tmp_path / "log"))
    return tmp_path / "a.pointer"


def test_a_reader_that_is_registered_reads_its_format(pointer: Path) -> None:
    assert open_log(pointer).name == "none"
    assert open_log(pointer, format="pointer", topics={"name": "x"}).name == "x"
    assert open_log(pointer.parent / "log").name != "none"


def test_what_is_said_of_a_format_is_that_of_all_registered(pointer: Path) -> None:
    with pytest.raises(InputError, match="format: expected folder, bag or pointer, found 'video'"):
        open_log(pointer, format="video")
    with pytest.raises(InputError, match=r"a ROS bag or a file that ends in \.pointer"):
        open_log(pointer.parent)
    with pytest.raises(InputError, match="--camera is for ROS bags, found a log of the format 'pointer'"):
        open_log(pointer, camera=pointer)
    with pytest.raises(InputError, match="no such log"):
        open_log(pointer.parent / "missing")


# -- files -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("durably", [False, True])
def test_interrupted_writing_leaves_what_was_there_before(tmp_path, monkeypatch, durably):
    path = tmp_path / "state"
    write_bytes(path, b"before", durably=durably)

    def fail(*_: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr("os.fsync" if durably else "pathlib.Path.replace", fail)
    with pytest.raises(OutputError, match="state: cannot be written: no space left"):
        write_bytes(path, b"after", durably=durably)
    assert path.read_bytes() == b"before"
    assert [file.name for file in tmp_path.iterdir()] == ["state"]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    require_new(tmp_path)
    require_new(tmp_path / "new")
    require_new_file(tmp_path / "file")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="expected a new or empty folder, found files in it"):
        require_new(tmp_path)
    with pytest.raises(OutputError, match="expected a new file, found one that is there already"):
        require_new_file(tmp_path / "file")
