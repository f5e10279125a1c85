"""Camera files: ROS keys and the mount."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from small_log import CAMERA

from localiser.camera import Camera, Mount, RollingShutter
from localiser.documents import dump, parse
from localiser.errors import InputError
from localiser.storage import read_camera, write_camera
from localiser.storage.cameras import camera_data, camera_from_document, degrees


def assert_same(first: Camera, second: Camera) -> None:
    for name in ("width", "height", "fx", "fy", "cx", "cy", "distortion_model", "distortion", "name"):
        assert getattr(first, name) == getattr(second, name), name
    assert first.mount.sigma is None and second.mount.sigma is None
    for name in set(Mount.__slots__) - {"sigma"}:
        assert getattr(first.mount, name) == pytest.approx(getattr(second.mount, name), rel=1e-14, abs=1e-15), name


def test_camera_is_read_back(tmp_path: Path) -> None:
    write_camera(CAMERA, tmp_path / "camera.yaml")
    assert_same(read_camera(tmp_path / "camera.yaml"), CAMERA)


def test_file_is_what_ros_reads_with_degrees_as_they_were_given(tmp_path: Path) -> None:
    write_camera(CAMERA, tmp_path / "camera.yaml")
    data = yaml.safe_load((tmp_path / "camera.yaml").read_text())
    assert data["camera_matrix"] == {"rows": 3, "cols": 3, "data": [50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0]}
    assert data["mount"]["tilt_deg"] == 20.0 and data["mount"]["back_m"] == -0.1


@given(st.floats(-180, 180).map(lambda value: round(value, 9)))
def test_degrees_survive_radians(angle_deg: float) -> None:
    assert degrees(np.radians(angle_deg)) == angle_deg


def test_mount_gives_what_is_left_out_as_zero() -> None:
    data = camera_data(CAMERA) | {"mount": {"tilt_deg": 10, "height_m": 1}}
    camera = camera_from_document(parse(dump(data), "f"))
    assert camera.mount == Mount(tilt_rad=np.radians(10), height_m=1.0)


def test_keys_that_ros_adds_for_stereo_are_accepted_where_they_change_nothing() -> None:
    unit = {"rows": 3, "cols": 3, "data": [1, 0, 0, 0, 1, 0, 0, 0, 1]}
    text = dump(camera_data(CAMERA) | {"rectification_matrix": unit})
    assert_same(camera_from_document(parse(text, "f")), CAMERA)
    turned = unit | {"data": [0, 1, 0, -1, 0, 0, 0, 0, 1]}
    with pytest.raises(InputError, match=r"rectification_matrix\.data: expected the unit matrix"):
        camera_from_document(parse(dump(camera_data(CAMERA) | {"rectification_matrix": turned}), "f"))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"image_width": 0}, "image_width: expected greater than or equal to 2, found 0"),
        ({"image_widht": 3}, "image_widht: unknown key; the nearest known is 'image_width'"),
        ({"image_width": 10_000, "image_height": 9000}, "of at most 12500000 pixels, found 10000×9000"),
        ({"mount": None}, "mount: expected keys and values, found nothing"),
        ({"mount": {"height_m": 1}}, "mount.tilt_deg: expected a value, found nothing"),
        ({"mount": {"tilt_deg": 90, "height_m": 1}}, "mount.tilt_deg: expected less than 90"),
        ({"mount": {"tilt_deg": 9, "height_m": 0}}, "mount.height_m: expected greater than or equal to 0.001"),
        ({"distortion_model": "pinhole"}, "distortion_model: expected 'plumb_bob'"),
        ({"distortion_model": "equidistant"}, "expected 4 numbers for equidistant, found 5"),
        ({"distortion_coefficients": {"rows": 1, "cols": 3, "data": [0, 0, 0]}}, "expected 0 or 4 or 5 numbers"),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": [1, 2]}}, "expected 3 rows, 3 cols and 9 numbers"),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": [9, 1, 9, 0, 9, 9, 0, 0, 1]}}, "expected [fx, 0, cx"),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": [-9, 0, 9, 0, 9, 9, 0, 0, 1]}}, "expected fx from 1"),
        (
            {"camera_matrix": {"rows": 3, "cols": 3, "data": [99, 0, -9, 0, 99, 9, 0, 0, 1]}},
            "right border, found cx = -9",
        ),
        ({"distortion_coefficients": {"rows": 1, "cols": 5, "data": [-2, 0, 0, 0, 0]}}, "up to the image's border"),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": [9, 0, ".nan", 0, 9, 9, 0, 0, 1]}}, "data[2]: expected"),
    ],
)
def test_errors_name_the_field(change: dict[str, object], expected: str) -> None:
    with pytest.raises(InputError) as caught:
        camera_from_document(parse(dump(camera_data(CAMERA) | change), "camera.yaml"))
    assert expected in str(caught.value) and str(caught.value).startswith("camera.yaml:")


def test_a_rolling_shutter_is_read_back(tmp_path: Path) -> None:
    camera = replace(CAMERA, shutter=RollingShutter(62.5e-6, stamp_row=23.5))
    write_camera(camera, tmp_path / "camera.yaml")
    data = yaml.safe_load((tmp_path / "camera.yaml").read_text())
    assert data["rolling_shutter"] == {"row_time_us": 62.5, "stamp_row": 23.5}
    assert read_camera(tmp_path / "camera.yaml").shutter == camera.shutter
    assert camera.readout_s == pytest.approx((-62.5e-6 * 23.5, 62.5e-6 * 23.5))


@pytest.mark.parametrize("stated", [None, {"row_time_us": 0}])
def test_a_camera_without_row_time_takes_all_rows_at_once(stated: dict[str, float] | None) -> None:
    data = camera_data(CAMERA)
    assert "rolling_shutter" not in data
    camera = camera_from_document(parse(dump(data | ({"rolling_shutter": stated} if stated else {})), "f"))
    assert camera.shutter is None and camera.readout_s == (0.0, 0.0)


@pytest.mark.parametrize(
    ("stated", "field", "found"),
    [
        ({"row_time_us": 50, "stamp_row": 48}, "rolling_shutter.stamp_row", "row of the image, 0 to 47, found 48"),
        ({"row_time_us": 2000}, "rolling_shutter.row_time_us", "1000"),
        ({"stamp_row": 0}, "rolling_shutter.row_time_us", "row_time_us"),
        ({"row_time_us": 50, "readout": 1}, "rolling_shutter.readout", "readout"),
    ],
)
def test_a_shutter_that_cannot_be_is_refused(stated: dict[str, float], field: str, found: str) -> None:
    with pytest.raises(InputError, match=found) as refused:
        camera_from_document(parse(dump(camera_data(CAMERA) | {"rolling_shutter": stated}), "f"))
    assert refused.value.field == field


# -- what other programs write ----------------------------------------------------------------------------------------

OPENCV = """%YAML:1.0
---
nframes: 20
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 319., 0., 501., 239., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data:[ -0.25, 0.1, 0.001, 0., 0. ]
"""
KALIBR = """cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.25, 0.1, 0.001, 0.0]
  distortion_model: radtan
  intrinsics: [500.0, 501.0, 319.0, 239.0]
  resolution: [640, 480]
cam1: {camera_model: omni}
"""
ORB = """%YAML:1.0

Camera.type: "PinHole"
{0}.fx: 500.0
{0}.fy: 501.0
{0}.cx: 319.0
{0}.cy: 239.0
{0}.k1: -0.25
{0}.k2: 0.1
{0}.p1: 0.001
Camera.width: 640
Camera.height: 480
ORBextractor.nFeatures: 1000
Viewer.PointSize:2
"""


@pytest.mark.parametrize(
    ("program", "text"),
    [("OpenCV", OPENCV), ("Kalibr", KALIBR), ("ORB-SLAM", ORB.format("Camera")), ("ORB-SLAM", ORB.format("Camera1"))],
)
def test_camera_files_of_other_programs(tmp_path: Path, program: str, text: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"mount: expected a mount, found none in a camera file of {program}"):
        read_camera(path)
    path.write_text(text + "mount: {tilt_deg: 20, height_m: 0.9}\n")
    camera = read_camera(path)
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (640, 480, 500, 501, 319, 239)
    assert (camera.distortion_model, camera.distortion[:4]) == ("plumb_bob", (-0.25, 0.1, 0.001, 0))
    assert not any(camera.distortion[4:]) and camera.mount.height_m == 0.9


def test_fisheye_lenses_of_other_programs(tmp_path: Path) -> None:
    mount = "mount: {tilt_deg: 20, height_m: 0.9}\n"
    orb = ORB.format("Camera").replace("PinHole", "KannalaBrandt8").replace("p1", "k3")
    opencv = OPENCV.replace("nframes: 20", "fisheye_model: 1").replace("0.001, 0., 0.", "0.001, 0.")
    for text in (orb, opencv, KALIBR.replace("radtan", "equidistant")):
        (tmp_path / "c.yaml").write_text(text + mount)
        camera = read_camera(tmp_path / "c.yaml")
        assert (camera.distortion_model, camera.distortion) == ("equidistant", (-0.25, 0.1, 0.001, 0))
    (tmp_path / "c.yaml").write_text(KALIBR.replace("pinhole", "omni") + mount)
    with pytest.raises(InputError, match=r"cam0\.camera_model: expected pinhole, found 'omni'"):
        read_camera(tmp_path / "c.yaml")


@pytest.mark.parametrize(
    ("model", "data", "expected"),
    [
        ("plumb_bob", [0.1, 0.2, 0, 0, 0.3, 0, 0, 0], ("plumb_bob", (0.1, 0.2, 0, 0, 0.3))),
        ("rational_polynomial", [0.1, 0.2, 0, 0, 0.3], ("rational_polynomial", (0.1, 0.2, 0, 0, 0.3, 0, 0, 0))),
        ("fisheye", [0.1, 0.2, 0, 0], ("equidistant", (0.1, 0.2, 0, 0))),
        ("none", [0, 0, 0, 0, 0], ("none", ())),
    ],
)
def test_coefficients_as_drivers_write_them(model: str, data: list[float], expected: tuple[str, object]) -> None:
    written = {"distortion_model": model, "distortion_coefficients": {"rows": 1, "cols": len(data), "data": data}}
    camera = camera_from_document(parse(dump(camera_data(CAMERA) | written), "f"))
    assert (camera.distortion_model, camera.distortion) == expected
