"""Trajectories: our CSV, and TUM as other programs read and write it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_log import TRUTH

from localiser.errors import InputError
from localiser.geometry import Trajectory
from localiser.storage import read_poses, read_tum, write_poses, write_tum
from localiser.storage.trajectories import nanoseconds, seconds, tum_line


def assert_close(found: Trajectory, expected: Trajectory) -> None:
    np.testing.assert_array_equal(found.t_ns, expected.t_ns)
    np.testing.assert_allclose(found.poses, expected.poses, atol=2e-9)


@given(st.integers(-(10**18), 10**18))
def test_times_lose_no_nanosecond(t_ns: int) -> None:
    assert nanoseconds(seconds(t_ns)) == t_ns


@pytest.mark.parametrize(
    ("text", "t_ns"),
    [
        ("1248444187.156", 1248444187156000000),
        ("1.248444187156000000e+09", 1248444187156000000),  # numpy.savetxt
        ("-0.5", -500_000_000),
        ("3", 3_000_000_000),
        ("1e-12", 0),
    ],
)
def test_times_of_other_programs(text: str, t_ns: int) -> None:
    assert nanoseconds(text) == t_ns


@pytest.mark.parametrize("text", ["nan", "inf", "1e999999999", "1e10", "1_0", "", "x", "9" * 200])
def test_what_is_no_time(text: str) -> None:
    with pytest.raises(ValueError, match="a time in seconds"):
        nanoseconds(text)


def test_tum_is_in_the_ros_frame() -> None:
    # Facing map -z is facing ROS +y: yaw 90 degrees; z = -2 is y = 2.
    line = tum_line(1_500_000_000, np.array([1.0, -2.0, 0.0]))
    half = "0.707106781"
    zero = "0.000000000"
    assert line == f"1.500000000 1.000000000 2.000000000 {zero} {zero} {zero} {half} {half}\n"


def test_trajectories_are_read_back(tmp_path: Path) -> None:
    write_tum(TRUTH, tmp_path / "t.tum")
    write_poses(TRUTH, tmp_path / "t.csv")
    assert_close(read_tum(tmp_path / "t.tum"), TRUTH)
    assert_close(read_poses(tmp_path / "t.csv"), TRUTH)


def test_evo_reads_the_same_poses(tmp_path: Path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    write_tum(TRUTH, tmp_path / "t.tum")
    path = file_interface.read_tum_trajectory_file(tmp_path / "t.tum")
    np.testing.assert_allclose(path.positions_xyz[:, :2], TRUTH.poses[:, :2] * [1, -1], atol=1e-9)
    np.testing.assert_allclose(path.timestamps, TRUTH.t_ns / 1e9)
    forward = np.array([matrix[:2, 0] for matrix in path.poses_se3])
    expected = np.stack([-np.sin(TRUTH.poses[:, 2]), np.cos(TRUTH.poses[:, 2])], axis=-1)
    np.testing.assert_allclose(forward, expected, atol=1e-8)


def test_tum_of_a_tilted_body_gives_its_yaw(tmp_path: Path) -> None:
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation
    x, y, z, w = rotation.from_euler("ZYX", [0.7, 0.3, -0.2]).as_quat()
    (tmp_path / "t.tum").write_text(f"# t x y z q\n\n0 1 2 3 {x} {y} {z} {w}\n")
    found = read_tum(tmp_path / "t.tum").poses[0]
    np.testing.assert_allclose(found, [1, -2, 0.7 - np.pi / 2], atol=1e-12)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "t.tum: expected at least one row, found none"),
        ("0 1 2 3\n", "t.tum:1: expected 8 columns (t, x, y, z, qx, qy, qz, qw), found 4"),
        ("# c\n0 1 nan 0 0 0 0 1\n", "t.tum:2: y: expected a finite number, found 'nan'"),
        ("1 1 2 0 0 0 0 1\n0 1 2 0 0 0 0 1\n", "t.tum:2: t: expected a time after 1000000000 ns, found 0 ns"),
        ("0 1 2 0 0 0 0 0\n", "t.tum:1: qx qy qz qw: expected a quaternion of length 1, found length 0"),
    ],
)
def test_errors_of_tum_files(tmp_path: Path, content: str, expected: str) -> None:
    (tmp_path / "t.tum").write_text(content)
    with pytest.raises(InputError) as caught:
        read_tum(tmp_path / "t.tum")
    assert str(caught.value).removeprefix(f"{tmp_path}/") == expected


def test_poses_need_a_row(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("t_ns,x,z,heading\n")
    with pytest.raises(InputError, match="expected at least 1 rows"):
        read_poses(tmp_path / "t.csv")


# -- forms told by the header -----------------------------------------------------------------------------------------


ROS = "{t},x,y,yaw\n{times[0]},1,2,1.5707963267948966\n{times[1]},1,3,0\n"
# Ahead of the robot is our -z: facing ROS +y is heading 0, and y = 2 is z = -2.
POSES = [[1.0, -2.0, 0.0], [1.0, -3.0, -np.pi / 2]]


@pytest.mark.parametrize(
    ("t", "times"),
    [
        ("t", ("1700000000.25", "1700000000.5")),
        ("t", ("1700000000250000000", "1700000000500000000")),
        ("t_ns", ("1700000000250000000", "1700000000500000000")),
    ],
)
def test_ros_axes_are_told_by_the_header(tmp_path: Path, t: str, times: tuple[str, str]) -> None:
    file = tmp_path / "odometry.csv"
    file.write_text(ROS.format(t=t, times=times))
    assert_close(read_poses(file), Trajectory(np.array([1700000000250000000, 1700000000500000000]), np.array(POSES)))
    assert "x,y,yaw" in file.read_text()
    file.write_text("yaw,y,x,t\n0,2,1,0\n0,3,1,2.5\n")  # in any order; seconds from the start
    np.testing.assert_array_equal(read_poses(file).t_ns, [0, 2_500_000_000])


@pytest.mark.parametrize("comment", ["", "# time x y z qx qy qz qw\n"])
def test_tum_is_told_by_its_lines(tmp_path: Path, comment: str) -> None:
    write_tum(TRUTH, tmp_path / "plain.tum")
    (tmp_path / "odometry.csv").write_text(comment + (tmp_path / "plain.tum").read_text())
    assert_close(read_poses(tmp_path / "odometry.csv"), TRUTH)


@pytest.mark.parametrize("header", ["time,px,py,theta", "t,x,y,theta", "t,x,y", "0.1,0,0,0", "stamp x y yaw"])
def test_an_unknown_header_is_told_with_the_formula_between_the_frames(tmp_path: Path, header: str) -> None:
    (tmp_path / "odometry.csv").write_text(f"{header}\n0,0,0,0\n")
    with pytest.raises(InputError) as refused:
        read_poses(tmp_path / "odometry.csv")
    told = str(refused.value)
    assert told.startswith(f"{tmp_path / 'odometry.csv'}:1: expected the header t_ns,x,z,heading")
    assert header in told and "x = x, z = -y, heading = yaw - π/2" in told


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("1.5,0,0,0\n1.5,0,0,0\n", "odometry.csv:3: t: expected a time after 1500000000"),
        ("soon,0,0,0\n", "odometry.csv:2: t: expected a time in seconds, or in whole nanoseconds"),
        ("1.5,0,left,0\n", "odometry.csv:2: y: expected a number, found 'left'"),
    ],
)
def test_a_bad_cell_with_ros_axes_is_told_by_line(tmp_path: Path, rows: str, said: str) -> None:
    (tmp_path / "odometry.csv").write_text(f"t,x,y,yaw\n{rows}")
    with pytest.raises(InputError, match=said):
        read_poses(tmp_path / "odometry.csv")
