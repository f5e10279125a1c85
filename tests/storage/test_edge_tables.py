"""Tables of edges: frames without edges, unknown cells, and the camera that is turned on the robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_log import CAMERA, sightings

from localiser import geometry
from localiser.errors import InputError
from localiser.storage.edge_tables import MOST_EDGES, read_edges, write_edges

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
    np.testing.assert_allclose(edges.bearing, geometry.bearing_from_point(x, z), atol=1e-6)
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
