"""Convert sensor_msgs/CameraInfo to the intrinsics of a camera, and back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from localiser.camera import Camera, Mount
from localiser.documents import Document, Place
from localiser.storage.cameras import camera_from_document


def camera_of(info: Any, mount: Mount, *, rectified: bool, name: str, source: str) -> Camera:
    """Return the camera that a CameraInfo describes, checked as a camera file is.

    rectified: whether the images had their lens distortion undone, and are those of the projection matrix. source: the
    bag, for errors. Raises InputError.
    """
    document = Document(_camera_file(info, rectified), {(): Place(source)})
    region = info.roi
    if info.binning_x > 1 or info.binning_y > 1 or region.x_offset or region.y_offset or region.do_rectify:
        raise document.error(("binning",), "expected images of the whole sensor, found binning or a region of interest")
    return replace(camera_from_document(document), mount=mount, name=name)


def intrinsics_of(info: Any, *, rectified: bool) -> dict[str, Any]:
    """Return all of a CameraInfo that a camera is made from, by name, to be compared with another's."""
    region = info.roi
    part = {
        "binning": (int(info.binning_x), int(info.binning_y)),
        "roi": (int(region.x_offset), int(region.y_offset), bool(region.do_rectify)),
    }
    return _camera_file(info, rectified) | part


def _camera_file(info: Any, rectified: bool) -> dict[str, Any]:
    """Return a CameraInfo as a camera file has it; ROS 1 writes the matrices' names in capitals."""
    coefficients, matrix, projection, rotation = (_array(info, name) for name in "dkpr")
    model = info.distortion_model or "none"
    if rectified:
        matrix = [*projection[0:3], *projection[4:7], *projection[8:11]]
        model, coefficients = "none", []
    if model == "none" and not any(coefficients):
        coefficients = []
    data = {
        "image_width": int(info.width),
        "image_height": int(info.height),
        "camera_matrix": {"rows": 3, "cols": 3, "data": matrix},
        "distortion_model": model,
        "distortion_coefficients": {"rows": 1, "cols": min(len(coefficients), 100), "data": coefficients},
        "mount": {"tilt_deg": 0.0, "height_m": 1.0},  # replaced by what the transforms say
    }
    if rectified:
        data["rectification_matrix"] = {"rows": 3, "cols": 3, "data": rotation}
    return data


def _array(info: Any, name: str) -> list[float]:
    values = getattr(info, name, None)
    values = getattr(info, name.upper()) if values is None else values
    return [float(value) for value in values[:100]]


def info_fields(camera: Camera) -> dict[str, Any]:
    """Return what a CameraInfo says of a camera: size, model and matrices, by their names in ROS 2."""
    matrix = camera.matrix
    return {
        "width": camera.width,
        "height": camera.height,
        "distortion_model": "" if camera.distortion_model == "none" else camera.distortion_model,
        "d": np.array(camera.distortion, dtype=np.float64),
        "k": matrix.ravel(),
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [*matrix[0], 0.0, *matrix[1], 0.0, *matrix[2], 0.0],
    }
