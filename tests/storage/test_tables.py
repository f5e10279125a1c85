"""CSV tables, and those of edges: every wrong cell is named with file, line and field."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_log import CAMERA, sightings

from localiser import geometry
from localiser.errors import InputError
from localiser.storage import tables
from localiser.storage.edge_tables import MOST_EDGES, read_edges, write_edges
from localiser.storage.tables import (
    Column,
    integer,
    name_or_none,
    number,
    number_or_unknown,
    positive_or_unknown,
    read_table,
    sign,
    text,
)

COLUMNS = (Column("t_ns", integer), Column("x", number), Column("note", text, required=False))


def problem(tmp_path: Path, content: str | bytes, **options: object) -> str:
    path = tmp_path / "table.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError) as caught:
        read_table(path, COLUMNS, **options).require_time_order(strictly=True)  # type: ignore[arg-type]
    return str(caught.value).removeprefix(f"{tmp_path}/")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "table.csv: expected the header 't_ns,x', found an empty file"),
        ("t_s,x\n", "table.csv:1: 't_s': unknown column; the nearest known is 't_ns'"),
        ("t_ns\n1\n", "table.csv:1: expected a column 'x' in the header 't_ns,x', found 't_ns'"),
        ("t_ns,x,x\n", "table.csv:1: 'x': column given twice"),
        ("t_ns,x,\n", "table.csv:1: '': unknown column"),
        ("t_ns,x\n1,2\n3\n", "table.csv:3: expected 2 cells, found 1"),
        ("t_ns,x\n1,2\n1.5,2\n", "table.csv:3: t_ns: expected an integer, found '1.5'"),
        ("t_ns,x\n1e9,2\n", "table.csv:2: t_ns: expected an integer, found '1e9'"),
        (f"t_ns,x\n{2**62},2\n", "table.csv:2: t_ns: expected an integer below 2^62"),
        ("t_ns,x\n1,nan\n", "table.csv:2: x: expected a finite number, found 'nan'"),
        ("t_ns,x\n1,-inf\n", "table.csv:2: x: expected a finite number, found '-inf'"),
        ("t_ns,x\n1,1e300\n", "table.csv:2: x: expected a number within ±1e+09, found '1e300'"),
        ("t_ns,x\n1,1_0\n", "table.csv:2: x: expected a number, found '1_0'"),
        ("t_ns,x\n1,١\n", "table.csv:2: x: expected a number, found '١'"),
        ("t_ns,x\n1,\n", "table.csv:2: x: expected a number, found an empty cell"),
        ("t_ns,x\n\n5,2\n4,2\n", "table.csv:4: t_ns: expected a time after 5, found 4"),
        ("t_ns,x\n5,2\n5,2\n", "table.csv:3: t_ns: expected a time after 5, found 5"),
        ('t_ns,x\n1,"2\n', "table.csv:2: not valid CSV"),
        (b"t_ns,x\n1,\xff\n", "table.csv:2: expected UTF-8 text, found byte 0xff"),
    ],
)
def test_errors_name_line_field_and_what_was_found(tmp_path: Path, content: str | bytes, expected: str) -> None:
    assert problem(tmp_path, content).startswith(expected)


def test_too_few_rows(tmp_path: Path) -> None:
    found = problem(tmp_path, "t_ns,x\n", rows_at_least=1)
    assert found == "table.csv: expected at least 1 rows after the header, found 0"


def test_columns_come_in_any_order_with_any_line_ends(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(b'\xef\xbb\xbfx, note ,t_ns\r\n 1.5,"a,b",-3\r\n2e-1,c,4\r\n')
    table = read_table(path, COLUMNS)
    np.testing.assert_array_equal(table.integers("t_ns"), [-3, 4])
    np.testing.assert_array_equal(table.numbers("x"), [1.5, 0.2])
    assert table.columns["note"] == ["a,b", "c"]
    assert table.lines == [2, 3]


def test_columns_of_a_newer_version_are_kept_as_text(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("t_ns,x,later\n1,2,hello\n")
    assert read_table(path, COLUMNS, more_columns=True).columns["later"] == ["hello"]


def test_cells_that_may_be_empty() -> None:
    assert np.isnan(number_or_unknown(" ")) and np.isnan(positive_or_unknown(""))
    assert (name_or_none(""), name_or_none("-1"), name_or_none(" door ")) == ("", "", "door")
    assert [sign(cell) for cell in ("", "0", "1", "+1", "-1")] == [0, 0, 1, 1, -1]


@pytest.mark.parametrize(
    ("read", "cell"),
    [(positive_or_unknown, "0"), (positive_or_unknown, "-1"), (name_or_none, "x" * 256), (sign, "2"), (text, " ")],
)
def test_cells_out_of_range_are_refused(read: object, cell: str) -> None:
    with pytest.raises(ValueError):
        read(cell)  # type: ignore[operator]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("t_ns,x\n" + "," * 5000, "table.csv:2: expected at most 1000 columns, found 5001"),
        (",".join(f"c{k}" for k in range(100_000)), "expected at most 1000 columns, found 100000"),
    ],
)
def test_columns_are_limited(tmp_path: Path, content: str, said: str) -> None:
    assert said in problem(tmp_path, content)


def test_cells_are_limited_before_they_fill_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "MOST_CELLS", 10)
    assert "table.csv:6: expected at most 10 cells, found more" in problem(tmp_path, "t_ns,x\n" + "1,2\n" * 9)


HEADER = "t_ns,bearing_rad,bearing_sigma_rad,lean_rad,lean_sigma_rad,length_px,polarity\n"


def write(folder: Path, rows: str, header: str = HEADER) -> Path:
    (folder / "edges.csv").write_text(header + rows)
    return folder / "edges.csv"


def test_frames_are_read_back_those_without_edges_too(tmp_path: Path) -> None:
    write_edges(sightings(), CAMERA, tmp_path / "edges.csv")
    found = read_edges(tmp_path / "edges.csv", CAMERA)[0]
    assert [frame.t_ns for frame in found] == [frame.t_ns for frame in sightings()]
    assert [len(frame.edges) for frame in found] == [2, 0, 2]
    for frame, expected in zip(found, sightings(), strict=True):
        for name in ("bearing", "bearing_sigma", "lean", "lean_sigma", "length_px", "polarity"):
            np.testing.assert_allclose(getattr(frame.edges, name), getattr(expected.edges, name), atol=1e-15)


def test_bearings_in_the_file_are_from_the_robot_and_inside_from_the_camera(tmp_path: Path) -> None:
    # A landmark 30 degrees to the right of where the robot faces, far away; the camera is turned 2 degrees left.
    path = write(tmp_path, f"5,{np.radians(30)},0.01,,,,\n")
    edges = read_edges(path, CAMERA)[0][0].edges
    point = 1e6 * np.array([[np.sin(np.radians(30)), -np.cos(np.radians(30))]])
    x, z = geometry.robot_from_map(CAMERA.pose_in_map(np.zeros(3)), point)[0]
    np.testing.assert_allclose(edges.bearing, np.arctan2(x, -z), atol=1e-6)
    np.testing.assert_allclose(np.degrees(edges.bearing), 32.0)
    write_edges(read_edges(path, CAMERA)[0], CAMERA, tmp_path / "back.csv")
    assert float((tmp_path / "back.csv").read_text().splitlines()[1].split(",")[1]) == pytest.approx(np.radians(30))


def test_lean_follows_from_bearing_and_bearing_from_lean(tmp_path: Path) -> None:
    path = write(tmp_path, "5,0.3,0.01,,,,\n5,,,0.2,0.02,33.5,-1\n")
    edges = read_edges(path, CAMERA)[0][0].edges
    tilt = CAMERA.mount.tilt_rad
    np.testing.assert_allclose(edges.lean, [np.arctan(np.sin(tilt) * np.tan(edges.bearing[0])), 0.2])
    np.testing.assert_allclose(edges.bearing[1], np.arctan(np.tan(0.2) / np.sin(tilt)))
    np.testing.assert_allclose(edges.bearing_sigma[1], 0.02 * geometry.bearing_per_lean(edges.bearing[1], tilt))
    np.testing.assert_array_equal(edges.polarity, [0, -1])
    np.testing.assert_array_equal(edges.landmark_id, [-1, -1])


def test_landmarks_are_known_by_id_and_line(tmp_path: Path) -> None:
    header = HEADER.replace("polarity", "polarity,landmark_id")
    rows = '5,0.3,0.01,,,,,"left, door"\n5,0.4,0.01,,,,,\n6,0.3,0.01,,,,,7\n6,0.2,0.01,,,,,"left, door"\n'
    frames, named = read_edges(write(tmp_path, rows, header), CAMERA)
    assert [(name, place.line) for name, place in named.items()] == [("left, door", 2), ("7", 4)]
    assert [frame.edges.landmark_id.tolist() for frame in frames] == [[0, -1], [1, 0]]
    write_edges(frames, CAMERA, tmp_path / "back.csv", tuple(named))
    again, names = read_edges(tmp_path / "back.csv", CAMERA)
    assert list(names) == list(named) and [frame.edges.landmark_id.tolist() for frame in again] == [[0, -1], [1, 0]]


def test_without_tilt_the_lean_stays_unknown(tmp_path: Path) -> None:
    level = CAMERA.with_mount(tilt_rad=0.0)
    assert np.isnan(read_edges(write(tmp_path, "5,0.3,0.01,,,,\n"), level)[0][0].edges.lean).all()


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ("", "edges.csv: expected at least 1 rows"),
        ("5,0.1,,,,,\n", "edges.csv:2: bearing_sigma_rad: expected bearing_rad and bearing_sigma_rad, found one"),
        ("5,,0.1,,,,\n", "edges.csv:2: bearing_rad: expected a bearing or a lean, found neither"),
        ("5,0.1,0.1,,0.2,,\n", "edges.csv:2: lean_rad: expected lean_rad and lean_sigma_rad, found one of them"),
        ("5,0.1,0,,,,\n", "edges.csv:2: bearing_sigma_rad: expected a number above 0, found '0'"),
        ("5,,,,,30,\n", "edges.csv:2: bearing_rad: expected a bearing or a lean, found neither"),
        ("5,,,,,,1\n", "edges.csv:2: bearing_rad: expected a bearing or a lean, found neither"),
        ("5,1.6,0.1,,,,\n", "edges.csv:2: bearing_rad: expected a bearing within ±90° of the camera's axis, found 1.6"),
        ("5,,,-1.6,0.1,,\n", "edges.csv:2: lean_rad: expected a lean within ±90°"),
        ("5,0.1,0.1,,,,2\n", "edges.csv:2: polarity: expected 1, -1 or 0, found '2'"),
        ("5,0.1,0.1,,,,\n4,0.1,0.1,,,,\n", "edges.csv:3: t_ns: expected a time not before 5, found 4"),
    ],
)
def test_errors_name_line_and_field(tmp_path: Path, rows: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        read_edges(write(tmp_path, rows), CAMERA)
    assert str(caught.value).removeprefix(f"{tmp_path}/").startswith(expected)


def test_bearing_behind_the_robot_is_before_a_camera_that_looks_back(tmp_path: Path) -> None:
    back = replace(CAMERA, mount=replace(CAMERA.mount, yaw_rad=np.pi))
    edges = read_edges(write(tmp_path, "5,3.0,0.01,,,,\n"), back)[0][0].edges
    np.testing.assert_allclose(edges.bearing, 3.0 - np.pi)


def test_an_image_of_too_many_edges_is_told(tmp_path: Path) -> None:
    path = write(tmp_path, "5,0.1,0.01,,,,\n" + "6,0.1,0.01,,,,\n" * (MOST_EDGES + 1))
    with pytest.raises(InputError, match=r"edges.csv:2003: t_ns: expected at most 2000 edges in an image, found 2001"):
        read_edges(path, CAMERA)
