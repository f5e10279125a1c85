"""Mounts that move in bags: written and read back with their sigmas, and as other programs record them."""

from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
from small_bag import KINDS, NAMES, OPTICAL, Recorder, recording
from small_log import CAMERA, IMAGE_TIMES, ODOMETRY, TRUTH, image

from localiser.camera import Mount, MountSigma
from localiser.errors import InputError
from localiser.storage import ImageEvent, Log, open_log, write_bag, write_log
from localiser.storage.bags.records import RosType

MOVED = replace(CAMERA.mount, tilt_rad=np.radians(25.0), roll_rad=np.radians(-2.0), yaw_rad=0.5, height_m=1.1)
SIGMA = MountSigma(tilt_rad=np.radians(0.4), roll_rad=np.radians(0.2), height_m=0.01)
MILLISECOND = 10**6


def log_with(mounts: list[Mount | None], folder: Path) -> Log:
    images = [(t_ns, image(index)) for index, t_ns in enumerate(IMAGE_TIMES)]
    write_log(folder, name="a", camera=CAMERA, odometry=ODOMETRY, images=images, mounts=mounts, groundtruth=TRUTH)
    return open_log(folder)


def mounts_of(log: Log) -> list[Mount | None]:
    return [frame.mount for frame in log.frames if isinstance(frame, ImageEvent)]


def assert_same(found: Mount | None, wanted: Mount) -> None:
    np.testing.assert_allclose(astuple(found)[:-1], astuple(wanted)[:-1], rtol=0, atol=1e-9)
    assert (found.sigma is None) == (wanted.sigma is None)
    if found.sigma is not None and wanted.sigma is not None:
        for mine, theirs in zip(astuple(found.sigma), astuple(wanted.sigma), strict=True):
            assert mine == (None if theirs is None else pytest.approx(theirs, abs=1e-9))


@KINDS
@pytest.mark.parametrize(
    "mounts",
    [
        [MOVED, replace(MOVED, tilt_rad=-0.2, roll_rad=0.3, right_m=0.2), None],
        [replace(MOVED, sigma=SIGMA), replace(CAMERA.mount, sigma=SIGMA), replace(MOVED, sigma=SIGMA)],
    ],
    ids=["mounts", "sigmas"],
)
def test_mounts_come_back_from_a_bag(tmp_path: Path, kind: str, mounts: list[Mount | None]) -> None:
    write_bag(tmp_path / NAMES[kind], log_with(mounts, tmp_path / "log"), kind)
    for found, wanted in zip(mounts_of(open_log(tmp_path / NAMES[kind])), mounts, strict=True):
        assert_same(found, wanted or CAMERA.mount)


def test_sigmas_that_a_bag_cannot_hold_are_refused(tmp_path: Path) -> None:
    mounts: list[Mount | None] = [replace(MOVED, sigma=MountSigma(yaw_rad=sigma)) for sigma in (0.1, 0.2, 0.3)]
    with pytest.raises(InputError, match="expected one sigma of the mount's yaw_rad for all images"):
        write_bag(tmp_path / "bag", log_with(mounts, tmp_path / "log"), "mcap")


# -- as other programs record them ------------------------------------------------------------------------------------


def about_y(angle: float) -> tuple[float, float, float, float]:
    return 0.0, float(np.sin(angle / 2)), 0.0, float(np.cos(angle / 2))


def moving(to: Recorder, t_ns: int, parent: str, child: str, z: float, turned: tuple[float, ...]) -> None:
    to.transform(parent, child, (0.0, 0.0, z), turned, "/tf", t_ns)


def tilts_deg(log: Log) -> list[float]:
    return [float(np.degrees(mount.tilt_rad)) for mount in mounts_of(log) if mount is not None]


def test_a_head_that_tilts_is_interpolated_at_the_images(tmp_path: Path) -> None:
    with recording(tmp_path / "bag") as to:
        to.info()
        to.transform("head", "optical", (0.0, 0.0, 0.0), OPTICAL)
        for step in range(11):
            t_ns = step * 100 * MILLISECOND
            to.odometry(t_ns, 0.01 * step)
            moving(to, t_ns, "base_link", "head", 0.7 + 0.01 * step, about_y(np.radians(3.0 * step)))
            moving(to, t_ns, "odom", "base_link", 0.0, about_y(0.0))
        for t_ms in (100, 250, 475):
            to.image(t_ms * MILLISECOND)
    log = open_log(tmp_path / "bag")
    np.testing.assert_allclose(tilts_deg(log), [3.0, 7.5, 14.25], atol=1e-6)
    heights = [mount.height_m for mount in mounts_of(log) if mount is not None]
    np.testing.assert_allclose(heights, [0.71, 0.725, 0.7475], atol=1e-9)


def test_a_robot_that_leans_over_its_footprint(tmp_path: Path) -> None:
    """The camera is fixed on base_link; base_link leans over base_footprint, and lifts the camera on its way."""
    with recording(tmp_path / "bag") as to:
        to.info()
        to.transform("base_link", "optical", (0.0, 0.0, 1.0), OPTICAL)
        for step in range(11):
            to.odometry(step * 100 * MILLISECOND, 0.01 * step)
            moving(to, step * 100 * MILLISECOND, "base_footprint", "base_link", 0.1, about_y(np.radians(step)))
        to.image(0)
        to.image(600 * MILLISECOND)
    upright, leaning = mounts_of(open_log(tmp_path / "bag"))
    assert np.degrees(leaning.tilt_rad) == pytest.approx(6.0)
    assert upright.height_m == pytest.approx(1.1) and leaning.height_m == pytest.approx(0.1 + np.cos(np.radians(6.0)))
    assert leaning.back_m == pytest.approx(-np.sin(np.radians(6.0)))


def test_transforms_between_other_frames_change_nothing(tmp_path: Path) -> None:
    with recording(tmp_path / "bag") as to:
        to.setting()
        to.image(0)
        moving(to, 0, "odom", "base_link", 1e5, about_y(0.0))
        moving(to, 0, "base_link", "wheel", 0.1, about_y(1.0))
    assert mounts_of(open_log(tmp_path / "bag")) == [None]


def test_transforms_that_pause_are_refused(tmp_path: Path) -> None:
    with recording(tmp_path / "bag") as to:
        to.info()
        for step in range(11):
            to.odometry(step * 100 * MILLISECOND, 0.01 * step)
        moving(to, 0, "base_link", "optical", 0.7, OPTICAL)
        to.image(900 * MILLISECOND)
    with pytest.raises(InputError, match=r"from 'base_link' to 'optical' within 0.5 s of the image at 900000000 ns"):
        open_log(tmp_path / "bag")


@pytest.mark.parametrize("fused", [False, True])
def test_tilt_by_an_inertial_sensor(tmp_path: Path, fused: bool) -> None:
    """It is fixed on the robot's base, which leans by 4° and then by 8°; the camera is level on the base."""
    with recording(tmp_path / "bag") as to:
        to.setting()
        to.transform("base_link", "imu", (0.0, 0.1, 0.2), (0.0, 0.0, 1.0, 0.0))  # looks backwards
        for step in range(1001):
            t_ns = step * MILLISECOND
            lean = np.radians(4.0 + 0.004 * step)
            covariance = np.zeros(9)
            covariance[0], covariance[4] = (-1.0, 0.0) if fused else (np.radians(0.5) ** 2, np.radians(0.25) ** 2)
            half = lean / 2  # Ry(lean) · Rz(π): up is ahead of the base, behind in the sensor
            turned = {"x": np.sin(half), "y": 0.0, "z": np.cos(half), "w": 0.0}
            pull = 9.81 * np.array([np.sin(lean), 0.0, np.cos(lean)])
            rate = np.radians(4.0)
            to.send(
                "/imu",
                RosType.IMU,
                t_ns,
                header=to.header(t_ns, "imu"),
                orientation={"w": 1.0} if fused else turned,
                orientation_covariance=covariance,
                angular_velocity={"y": -rate},
                linear_acceleration=dict(zip("xyz", pull, strict=True)),
            )
        to.image(0)
        to.image(1000 * MILLISECOND)
    assert mounts_of(open_log(tmp_path / "bag")) == [None, None]  # not asked for
    log = open_log(tmp_path / "bag", topics={"imu": "/imu"})
    np.testing.assert_allclose(tilts_deg(log), [4.0, 8.0], atol=0.5 if fused else 1e-6)
    for mount in mounts_of(log):
        assert mount.sigma.tilt_rad is not None
        assert np.degrees(mount.sigma.tilt_rad) == pytest.approx(0.25, abs=1e-6) or fused
        assert mount.roll_rad == pytest.approx(0.0, abs=1e-3)
