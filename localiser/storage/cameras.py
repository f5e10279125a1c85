"""Camera files: the keys of ROS `camera_info` for the intrinsics, and the mount in degrees and metres."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from localiser.camera import DISTORTION_COUNTS, Camera, Mount
from localiser.documents import Document, dump, load, shown, validate
from localiser.storage.files import write_text

Metres = Annotated[float, Field(ge=-100, le=100)]
Degrees = Annotated[float, Field(ge=-180, le=180)]
Pixels = Annotated[int, Field(ge=2, le=2**14)]
FileModel = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class MatrixFile(BaseModel):
    """A matrix as ROS writes it, row by row."""

    model_config = FileModel

    rows: Annotated[int, Field(ge=0, le=100)]
    cols: Annotated[int, Field(ge=0, le=100)]
    data: list[float]


class MountFile(BaseModel):
    """Where the camera sits in the robot frame."""

    model_config = FileModel

    tilt_deg: Annotated[float, Field(gt=-90, lt=90)]
    height_m: Annotated[float, Field(gt=0, le=100)]
    roll_deg: Degrees = 0.0
    right_m: Metres = 0.0
    back_m: Metres = 0.0
    yaw_deg: Degrees = 0.0


class CameraFile(BaseModel):
    """A camera file. What ROS adds for stereo pairs and for cutting is accepted where it changes nothing."""

    model_config = FileModel

    image_width: Pixels
    image_height: Pixels
    camera_matrix: MatrixFile
    mount: MountFile
    camera_name: str = ""
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant", "none"] = "none"
    distortion_coefficients: MatrixFile | None = None
    rectification_matrix: MatrixFile | None = None
    projection_matrix: MatrixFile | None = None


def load_camera(path: Path) -> Camera:
    """Return the camera that a file describes. Raises InputError."""
    return camera_from_document(load(path))


def camera_from_document(document: Document) -> Camera:
    """Return the camera that a document describes. Raises InputError."""
    file = validate(document, CameraFile)
    fx, fy, cx, cy = _intrinsics(document, file.camera_matrix)
    _check_rectification(document, file.rectification_matrix)
    mount = file.mount
    return Camera(
        width=file.image_width,
        height=file.image_height,
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        mount=Mount(
            tilt_rad=math.radians(mount.tilt_deg),
            height_m=mount.height_m,
            roll_rad=math.radians(mount.roll_deg),
            yaw_rad=math.radians(mount.yaw_deg),
            right_m=mount.right_m,
            back_m=mount.back_m,
        ),
        distortion_model=file.distortion_model,
        distortion=_distortion(document, file),
        name=file.camera_name,
    )


def _intrinsics(document: Document, matrix: MatrixFile) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of a matrix without skew."""
    key = ("camera_matrix", "data")
    if (matrix.rows, matrix.cols, len(matrix.data)) != (3, 3, 9):
        raise document.error(key, f"expected 3 rows, 3 cols and 9 numbers, found {_shape(matrix)}")
    fx, skew, cx, p, fy, cy, *last = matrix.data
    if [skew, p, *last] != [0, 0, 0, 0, 1]:
        raise document.error(key, f"expected [fx, 0, cx, 0, fy, cy, 0, 0, 1], found {shown(matrix.data)}")
    for name, focal in (("fx", fx), ("fy", fy)):
        if not 1 <= focal <= 1e6:
            raise document.error(key, f"expected {name} from 1 to 1e6 px, found {focal}")
    for name, centre in (("cx", cx), ("cy", cy)):
        if abs(centre) > 1e6:
            raise document.error(key, f"expected {name} within ±1e6 px, found {centre}")
    return fx, fy, cx, cy


def _distortion(document: Document, file: CameraFile) -> tuple[float, ...]:
    """Return the coefficients, as many as the model has."""
    key = ("distortion_coefficients", "data")
    found = file.distortion_coefficients.data if file.distortion_coefficients else []
    counts = DISTORTION_COUNTS[file.distortion_model]
    if len(found) not in counts:
        wanted = " or ".join(str(count) for count in counts)
        raise document.error(key, f"expected {wanted} numbers for {file.distortion_model}, found {len(found)}")
    if any(abs(value) > 1e6 for value in found):
        raise document.error(key, f"expected coefficients within ±1e6, found {shown(found)}")
    return tuple(found)


def _check_rectification(document: Document, matrix: MatrixFile | None) -> None:
    """Refuse a stereo camera's rectification, which would turn the image and is not applied."""
    if matrix is not None and matrix.data != [1, 0, 0, 0, 1, 0, 0, 0, 1]:
        raise document.error(("rectification_matrix", "data"), f"expected the unit matrix, found {shown(matrix.data)}")


def _shape(matrix: MatrixFile) -> str:
    return f"{matrix.rows} rows, {matrix.cols} cols and {len(matrix.data)} numbers"


def save_camera(camera: Camera, path: Path) -> None:
    """Write a camera file. Raises OutputError."""
    write_text(path, dump(camera_data(camera)))


def camera_data(camera: Camera) -> dict[str, Any]:
    """Return the camera as plain data, as its file has it."""
    mount = camera.mount
    return {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": camera.name,
        "camera_matrix": {
            "rows": 3,
            "cols": 3,
            "data": [float(value) for value in camera.matrix.ravel()],
        },
        "distortion_model": camera.distortion_model,
        "distortion_coefficients": {
            "rows": 1,
            "cols": len(camera.distortion),
            "data": [float(value) for value in camera.distortion],
        },
        "mount": {
            "tilt_deg": degrees(mount.tilt_rad),
            "roll_deg": degrees(mount.roll_rad),
            "height_m": float(mount.height_m),
            "right_m": float(mount.right_m),
            "back_m": float(mount.back_m),
            "yaw_deg": degrees(mount.yaw_rad),
        },
    }


def degrees(angle_rad: float) -> float:
    """Return an angle in degrees to 15 digits, so that 20 degrees come back as 20."""
    return float(f"{math.degrees(angle_rad):.15g}")
