"""Trajectories: our CSV, and TUM as other programs read and write it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_log
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from small_log import TRUTH

from localiser.errors import InputError, InputWarning
from localiser.filter import Start
from localiser.geometry import Trajectory
from localiser.storage import open_log, read_poses, write_log, write_poses, write_tum
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
    assert_close(read_poses(tmp_path / "t.tum"), TRUTH)
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
    found = read_poses(tmp_path / "t.tum").poses[0]
    np.testing.assert_allclose(found, [1, -2, 0.7 - np.pi / 2], atol=1e-12)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("# t\n", ": expected at least one row, found none"),
        ("0 1 2 0 0 0 0 1\n1 2 3\n", ":2: expected 8 columns (t, x, y, z, qx, qy, qz, qw), found 3"),
        ("# c\n0 1 east 0 0 0 0 1\n", ":2: y: expected a number, found 'east'"),
        ("1.50 1 2 0 0 0 0 1\n0 1 2 0 0 0 0 1\n", ":2: t: expected a time not before 1.50, found 0"),
        ("0 1 2 0 0 0 0 2\n", ":1: qx qy qz qw: expected a quaternion of length 1, found length 2"),
        ("t_ns,x,z,heading\n", ": expected at least 1 rows after the header, found 0"),
        ("t,x,y,yaw\n1.5,0,0,0\n1.25,0,0,0\n", ":3: t: expected a time not before 1.5, found 1.25"),
        ("t,x,y,yaw\nsoon,0,0,0\n", ":2: t: expected a time in seconds, found 'soon'"),
    ],
)
def test_errors_have_a_line_and_a_column(tmp_path: Path, content: str, expected: str) -> None:
    (tmp_path / "poses").write_text(content)
    with pytest.raises(InputError) as caught:
        read_poses(tmp_path / "poses")
    assert str(caught.value) == f"{tmp_path / 'poses'}{expected}"


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


@pytest.mark.parametrize("header", ["time,px,py,theta", "t,x,y,theta", "t,x,y", "stamp x y yaw", ",,,"])
def test_an_unknown_header_is_told_with_the_formula_between_the_frames(tmp_path: Path, header: str) -> None:
    (tmp_path / "odometry.csv").write_text(f"{header}\n0,0,0,0\n")
    with pytest.raises(InputError) as refused:
        read_poses(tmp_path / "odometry.csv")
    told = str(refused.value)
    assert told.startswith(f"{tmp_path / 'odometry.csv'}:1: expected the header t_ns,x,z,heading")
    assert header in told and "x = x, z = -y, heading = yaw - π/2" in told


# -- what other programs write ----------------------------------------------------------------------------------------

TURNS = Rotation.from_euler("Z", np.linspace(0.3, 2.0, 30)[:, None])
PLACES = np.column_stack([np.linspace(0, 4, 30), np.linspace(1, 3, 30), np.zeros(30)])
T_S = np.arange(30) / 10 + 1_600_000_000.0
OURS = np.column_stack([PLACES[:, 0], -PLACES[:, 1], np.linspace(0.3, 2.0, 30) - np.pi / 2])


def tum(path: Path, places: np.ndarray, q: np.ndarray, line: Callable[[int, str], str] = lambda _, text: text) -> Path:
    rows = (f"{t:.4f} {' '.join(map(str, [*place, *turn]))}" for t, place, turn in zip(T_S, places, q, strict=True))
    path.write_text("# time x y z q\n" + "\n".join(line(index, row) for index, row in enumerate(rows)) + "\n")
    return path


def test_of_two_poses_at_one_time_the_first_is_kept_and_that_is_told(tmp_path: Path) -> None:
    file = tum(tmp_path / "t.tum", PLACES, TURNS.as_quat(), lambda index, row: f"{row}\n{row}" if index == 7 else row)
    with pytest.warns(InputWarning, match=r"t.tum:10: left out 1 of 31 poses .* such as 1600000000\.7000$"):
        np.testing.assert_allclose(read_poses(file).poses, OURS)
    for end in ("\n", "\r"):
        (tmp_path / "o.csv").write_text(end.join(("t_ns,x,z,heading", "5,1,0,0", "5,2,0,0", "6,3,0,0", "")))
        with pytest.warns(InputWarning, match="left out 1 of 3 .* such as 5"):
            assert read_poses(tmp_path / "o.csv").poses[:, 0].tolist() == [1, 3]


@pytest.mark.parametrize("lost", ["nan nan nan nan nan nan nan", "null null null 0 0 0 1", "0 0 0 0 0 0 0"])
def test_lost_poses_are_left_out_up_to_a_tenth(tmp_path: Path, lost: str) -> None:
    def lose(count: int) -> Callable[[int, str], str]:
        return lambda index, row: f"{row.split()[0]} {lost}" if 4 < index <= 4 + count else row

    file = tum(tmp_path / "t.tum", PLACES, TURNS.as_quat(), lose(3))
    with pytest.warns(InputWarning, match="left out 3 of 30 poses that are empty, null or nan"):
        np.testing.assert_allclose(read_poses(file).poses, np.delete(OURS, [5, 6, 7], axis=0))
    tum(file, PLACES, TURNS.as_quat(), lose(4))
    with pytest.raises(InputError, match=r"t.tum:7: .*expected at most a tenth .* found 4 of 30"):
        read_poses(file)
    (tmp_path / "o.csv").write_text("t_ns,x,z,heading\n" + "".join(f"{k},{k},0,0\n" for k in range(9)) + "9,,NaN,\n")
    with pytest.warns(InputWarning, match="left out 1 of 10"):
        assert len(read_poses(tmp_path / "o.csv")) == 9


def test_a_quaternion_with_w_first_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"t.tum:2: qx qy qz qw: .* is the order of columns qw qx qy qz\?"):
        read_poses(tum(tmp_path / "t.tum", PLACES, TURNS.as_quat()[:, [3, 0, 1, 2]]))


CAMERA = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""What is along a camera's axes (right, down, ahead) along a robot's (ahead, left, up)."""


def test_paths_and_poses_in_a_cameras_axes_are_turned_and_that_is_told(tmp_path: Path) -> None:
    body = (TURNS * CAMERA * Rotation.from_euler("X", -20, degrees=True)).as_quat()
    with pytest.warns(InputWarning, match="y axis of the poses points down"):
        np.testing.assert_allclose(read_poses(tum(tmp_path / "b.tum", PLACES, body)).poses, OURS, atol=1e-9)
    places, turns = CAMERA.inv().apply(PLACES - PLACES[0]), CAMERA.inv() * TURNS * CAMERA
    expected = np.column_stack([places[:, 0], -places[:, 2], OURS[:, 2] + np.pi / 2])
    with pytest.warns(InputWarning, match="path lies in x and z"):
        np.testing.assert_allclose(read_poses(tum(tmp_path / "c.tum", places, turns.as_quat())).poses, expected)


def test_coordinates_of_utm_are_a_start_a_map_and_a_path(tmp_path: Path) -> None:
    far = np.array([500_000.25, -5_800_000.5, 0.5])
    landmark_map = replace(small_log.MAP, points=small_log.MAP.points + far[:2])
    start, odometry = Start(small_log.ODOMETRY.t_ns[0], far, np.diag([0.01, 0.01, 0.001])), small_log.ODOMETRY
    truth = Trajectory(odometry.t_ns, odometry.poses + far)
    write_log(
        tmp_path / "log", name="far", camera=small_log.CAMERA, odometry=odometry, sightings=small_log.sightings(),
        landmark_map=landmark_map, start=start, groundtruth=truth,
    )  # fmt: skip
    log = open_log(tmp_path / "log")
    np.testing.assert_allclose(log.start.mean, far, atol=1e-9)
    np.testing.assert_allclose(log.landmark_map.points, landmark_map.points, atol=1e-6)
    np.testing.assert_allclose(log.groundtruth.poses, truth.poses, atol=1e-6)


def test_axes_that_point_nowhere_are_told(tmp_path: Path) -> None:
    with pytest.warns(InputWarning, match="expected poses whose z axis points up"):
        read_poses(tum(tmp_path / "t.tum", PLACES, (TURNS * Rotation.from_euler("Y", 80, degrees=True)).as_quat()))


def test_euroc_and_tum_in_nanoseconds(tmp_path: Path) -> None:
    header, t_ns = "#timestamp, p_RS_R_x [m], y, z, q_RS_w [], q_x, q_y, q_z, v_x\n", (T_S * 1e9).astype(np.int64)
    q = TURNS.as_quat()[:, [3, 0, 1, 2]]
    rows = [",".join(map(str, [t, *place, *turn, 0.5])) for t, place, turn in zip(t_ns, PLACES, q, strict=True)]
    (tmp_path / "data.csv").write_text(header + "\n".join(rows) + "\n")
    assert_close(read_poses(tmp_path / "data.csv"), Trajectory(t_ns, OURS))
    in_seconds = "\n".join(f"{seconds(t)},{row.split(',', 1)[1]}" for t, row in zip(t_ns.tolist(), rows, strict=True))
    (tmp_path / "data.csv").write_text(in_seconds)
    assert_close(read_poses(tmp_path / "data.csv"), Trajectory(t_ns, OURS))
    tum(tmp_path / "t.tum", PLACES, TURNS.as_quat(), lambda index, row: f"{t_ns[index]} {row.split(maxsplit=1)[1]}")
    assert_close(read_poses(tmp_path / "t.tum"), Trajectory(t_ns, OURS))
