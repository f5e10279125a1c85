"""Read and write camera files: intrinsics by the keys of ROS `camera_info`, the mount in degrees and metres."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from localiser.camera import DISTORTION_COUNTS, Camera, Mount, RollingShutter
from localiser.documents import Document, dump, is_name, load, parse, read_text, shown, validate, write_text
from localiser.errors import InputError
from localiser.storage.files import CAMERA, inside, refuse_other

MOST_LENS_OFF_PX = 0.5  # at the border of the image, where a lens model is undone
MOST_PIXELS = 12_500_000  # cameras of robots have fewer; some 100 bytes of memory each while edges are found
Metres = Annotated[float, Field(ge=-100, le=100)]
Degrees = Annotated[float, Field(ge=-180, le=180)]
Pixels = Annotated[int, Field(ge=2, le=2**14)]
_ANGLES, _LENGTHS = ("tilt", "roll", "yaw"), ("height_m", "right_m", "back_m")
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
    height_m: Annotated[float, Field(ge=1e-3, le=100)]
    roll_deg: Degrees = 0.0
    right_m: Metres = 0.0
    back_m: Metres = 0.0
    yaw_deg: Degrees = 0.0


class ShutterFile(BaseModel):
    """How the rows of an image follow each other; row_time_us: negative where the last row is the first to be taken."""

    model_config = FileModel

    row_time_us: Annotated[float, Field(ge=-1000, le=1000)]
    stamp_row: Annotated[float, Field(ge=0, le=2**14)] = 0.0


class CameraFile(BaseModel):
    """A camera file. What ROS adds for stereo pairs and for cutting is accepted where it changes nothing."""

    model_config = FileModel

    image_width: Pixels
    image_height: Pixels
    camera_matrix: MatrixFile
    mount: MountFile
    camera_name: Annotated[str, is_name] = ""
    distortion_model: Annotated[
        Literal["plumb_bob", "rational_polynomial", "equidistant", "none"],
        BeforeValidator(lambda name: "equidistant" if name == "fisheye" else name),
    ] = "none"
    distortion_coefficients: MatrixFile | None = None
    rectification_matrix: MatrixFile | None = None
    projection_matrix: MatrixFile | None = None
    rolling_shutter: ShutterFile | None = None


def read_camera(path: Path | str) -> Camera:
    """Return the camera that a file describes, by the keys of ROS or as other programs write it. Raises InputError.

    OpenCV, Kalibr (cam0 of a camchain) and ORB-SLAM know no mount; a key `mount` is added to their files.
    """
    refuse_other(Path(path), CAMERA)
    text = read_text(Path(path))
    if text.startswith("%YAML"):  # OpenCV's is no YAML by its first line, its tag, and colons without a space
        text = "#" + re.sub(r"(?m)^([ \w.]+):(?=[^\s:])", r"\1: ", text.replace("!!opencv-matrix", ""))
    document = parse(text, str(path))
    value = document.value
    if not isinstance(value, dict) or (found := _of_other_program(document, value)) is None:
        return camera_from_document(document)
    name, data = found
    if "mount" not in value:
        problem = f"expected a mount, found none in a camera file of {name}: add the line"
        raise document.error(("mount",), f"{problem} `mount: {{tilt_deg: 20, height_m: 0.9}}`, with what you measure")
    return camera_from_document(Document(data | {"mount": value["mount"]}, document.places))


def _of_other_program(document: Document, value: dict[str, Any]) -> tuple[str, dict[str, Any]] | None:
    """Return the program that wrote a camera file, and its camera by the keys of ROS; None for a file of ours."""
    if isinstance(matrix := value.get("camera_matrix", value.get("Camera_Matrix")), dict) and "dt" in matrix:
        found = value.get("distortion_coefficients", value.get("Distortion_Coefficients"))
        bent = found.get("data") if isinstance(found, dict) else []
        size = [value.get(f"image_{side}", value.get(f"image_{side.title()}")) for side in ("width", "height")]
        many = isinstance(bent, list) and len(bent) > 5
        model = "equidistant" if value.get("fisheye_model") else "rational_polynomial" if many else "plumb_bob"
        return "OpenCV", ros_keys(size, matrix.get("data"), model, bent)
    if isinstance(camera := value.get("cam0"), dict):
        if camera.get("camera_model") != "pinhole":
            problem = f"expected pinhole, found {shown(camera.get('camera_model'))}"
            raise document.error(("cam0", "camera_model"), problem)
        lens = camera.get("distortion_model")
        known = {"radtan": "plumb_bob", "equi": "equidistant"}.get(str(lens), lens)
        data = _matrix_data(camera.get("intrinsics"))
        return "Kalibr", ros_keys(camera.get("resolution"), data, known, camera.get("distortion_coeffs"))
    prefix = next((prefix for prefix in ("Camera1.", "Camera.") if f"{prefix}fx" in value), None)
    if prefix is None:
        return None
    fisheye = str(value.get("Camera.type")).startswith("Kannala")
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    data = _matrix_data([value.get(f"{prefix}{name}") for name in ("fx", "fy", "cx", "cy")])
    bent = [value.get(f"{prefix}{name}", 0.0) for name in names]
    size = [value.get(f"Camera.{side}") for side in ("width", "height")]
    return "ORB-SLAM", ros_keys(size, data, "equidistant" if fisheye else "plumb_bob", bent)


def _matrix_data(intrinsics: Any) -> list[Any]:
    """Return the nine numbers of a camera matrix; None where one is missing."""
    given = intrinsics if isinstance(intrinsics, list) else []
    fx, fy, cx, cy = [*given, None, None, None, None][:4]
    return [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]


def ros_keys(size: Any, matrix: Any, model: Any, coefficients: Any) -> dict[str, Any]:
    """Return what was read of a camera by the keys of a camera file, not checked yet; it has no mount."""
    width, height = [*(size if isinstance(size, list) else []), None, None][:2]
    count = len(coefficients) if isinstance(coefficients, list) else 0
    return {
        "image_width": width,
        "image_height": height,
        "camera_matrix": {"rows": 3, "cols": 3, "data": matrix},
        "distortion_model": model,
        "distortion_coefficients": {"rows": 1, "cols": count, "data": coefficients},
    }


def camera_from_document(document: Document) -> Camera:
    """Return the camera that a document describes. Raises InputError."""
    file = validate(document, CameraFile)
    if file.image_width * file.image_height > MOST_PIXELS:
        problem = f"expected images of at most {MOST_PIXELS} pixels, found {file.image_width}×{file.image_height}"
        raise document.error(("image_width",), problem)
    intrinsics = _intrinsics(document, file.camera_matrix)
    rectification = file.rectification_matrix
    if rectification is not None and rectification.data != [1, 0, 0, 0, 1, 0, 0, 0, 1]:
        # A stereo camera's, which would turn the image and is not applied.
        problem = f"expected the unit matrix, found {shown(rectification.data)}"
        raise document.error(("rectification_matrix", "data"), problem)
    mount: dict[str, Any] = {f"{name}_rad": math.radians(getattr(file.mount, f"{name}_deg")) for name in _ANGLES}
    mount |= {name: getattr(file.mount, name) for name in _LENGTHS}
    model, distortion = file.distortion_model, _distortion(document, file)
    size = (file.image_width, file.image_height)
    shutter = shutter_of(file.rolling_shutter, file.image_height, document)
    camera = Camera(*size, *intrinsics, Mount(**mount), model, distortion, file.camera_name, shutter)
    left, right = camera.upright_bounds[:2]
    if not left < 0 < right:
        problem = f"expected a principal point between the image's left and right border, found cx = {intrinsics[2]:g}"
        raise document.error(("camera_matrix", "data"), problem)
    if problem := lens_problem(camera):
        raise document.error(("distortion_coefficients", "data"), problem)
    return camera


def lens_problem(camera: Camera) -> str:
    """Return what is wrong with a lens model that cannot be undone in the whole image, "" where nothing is."""
    border = camera.border_px().reshape(-1, 2)
    off_px = float(np.abs(camera.pixels_from_image(camera.image_from_pixels(border)) - border).max())
    if camera.distortion_model == "equidistant" or off_px < MOST_LENS_OFF_PX:
        return ""
    problem = f"expected a lens model that can be undone up to the image's border, found {off_px:.0f} px off there"
    return f"{problem}; `camera calibrate --lens equidistant` finds one for wide lenses"


def shutter_of(stated: ShutterFile | None, height: int, document: Document) -> RollingShutter | None:
    """Return how the shutter of images of a height rolls, None where it does not. Raises InputError."""
    if stated is None or stated.row_time_us == 0:
        return None
    if stated.stamp_row > height - 1:
        problem = f"expected a row of the image, 0 to {height - 1}, found {stated.stamp_row:g}"
        raise document.error(("rolling_shutter", "stamp_row"), problem)
    return RollingShutter(stated.row_time_us / 1e6, stated.stamp_row)


def shutter_data(shutter: RollingShutter) -> dict[str, float]:
    """Return the shutter as plain data, as files have it; to 15 digits, so that 62.5 µs come back as 62.5."""
    return {"row_time_us": float(f"{shutter.row_time_s * 1e6:.15g}"), "stamp_row": float(shutter.stamp_row)}


def _intrinsics(document: Document, matrix: MatrixFile) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of a matrix without skew."""
    key = ("camera_matrix", "data")
    if (matrix.rows, matrix.cols, len(matrix.data)) != (3, 3, 9):
        found = f"{matrix.rows} rows, {matrix.cols} cols and {len(matrix.data)} numbers"
        raise document.error(key, f"expected 3 rows, 3 cols and 9 numbers, found {found}")
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
    if file.distortion_model == "rational_polynomial" and len(found) in (4, 5):
        found = [*found, *[0.0] * (8 - len(found))]
    if file.distortion_model != "equidistant" and not any(found[counts[-1] :]):
        found = found[: counts[-1]]
    if len(found) not in counts:
        wanted = " or ".join(str(count) for count in counts)
        raise document.error(key, f"expected {wanted} numbers for {file.distortion_model}, found {len(found)}")
    if any(abs(value) > 1e6 for value in found):
        raise document.error(key, f"expected coefficients within ±1e6, found {shown(found)}")
    return tuple(found)


def write_camera(camera: Camera, path: Path | str, *, with_mount: bool = True, comment: str = "") -> None:
    """Write a camera file. Raises OutputError.

    with_mount: whether the mount is known; without, the file lacks it and the program asks for it. comment: lines to
    begin the file with.
    """
    data = camera_data(camera)
    if not with_mount:
        del data["mount"]
    write_text(Path(path), "".join(f"# {line}\n" for line in comment.splitlines()) + dump(data))


def named(document: Document, folder: Path, key: str, name: str) -> Path:
    """Return the path of the file in `folder` that the document names at `key`. Raises InputError."""
    try:
        return inside(folder, name)
    except ValueError as error:
        raise document.error((key,), f"{error}, found {name!r}") from None


def camera_error(log: Path, key: tuple[str, ...], problem: str) -> InputError:
    """Return the error that says what is wrong with the value at `key` of a log's camera file, and where it is."""
    try:
        return load(inside(log, load(log / "log.yaml").value["camera"])).error(key, problem)
    except (InputError, ValueError, TypeError, LookupError):  # a log of another format has no such file
        return InputError(problem, path=log, field=".".join(key))


def camera_data(camera: Camera) -> dict[str, Any]:
    """Return the camera as plain data, as its file has it."""
    angles = {f"{name}_deg": degrees(getattr(camera.mount, f"{name}_rad")) for name in _ANGLES}
    lengths = {name: float(getattr(camera.mount, name)) for name in _LENGTHS}
    coefficients = [float(value) for value in camera.distortion]
    return {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": camera.name,
        "camera_matrix": {"rows": 3, "cols": 3, "data": camera.matrix.ravel().tolist()},
        "distortion_model": camera.distortion_model,
        "distortion_coefficients": {"rows": 1, "cols": len(coefficients), "data": coefficients},
        "mount": angles | lengths,
    } | ({"rolling_shutter": shutter_data(camera.shutter)} if camera.shutter else {})


def degrees(angle_rad: float) -> float:
    """Return an angle in degrees to 15 digits, so that 20 degrees come back as 20."""
    return float(f"{math.degrees(angle_rad):.15g}")
