"""The mount of each image in images.csv: read, written, copied by convert, and refused with its place."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_log import CAMERA, IMAGE_TIMES, ODOMETRY, image, write_small_log

from localiser.camera import Mount, MountSigma
from localiser.errors import InputError
from localiser.storage import ImageEvent, open_log, write_log


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_log(tmp_path_factory.mktemp("logs") / "small", suffix=".png")


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
    assert second == replace(usual, height_m=1.5, sigma=MountSigma(tilt_rad=np.radians(0.2)))
    assert third is None


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
    assert found[1] is not None and found[1].sigma is not None
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
def test_a_mount_that_cannot_be_is_refused(
    written: Path, tmp_path: Path, column: str, cell: str, expected: str
) -> None:
    folder = with_columns(written, tmp_path / "log", column, "", cell, "")
    with pytest.raises(InputError, match=expected) as error:
        open_log(folder)
    assert error.value.line == 3 and error.value.field == column
