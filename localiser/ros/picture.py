"""The image with its edges drawn in, as a sensor_msgs/CompressedImage."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.filter import Image, LocatedFrame
from localiser.geometry import Array
from localiser.image_files import decode
from localiser.landmarks import predicted_lines
from localiser.storage import encode_image
from localiser.storage.bags import OPTICAL, Messages
from localiser.view import MATCHED, UNMATCHED, VISIBLE, Colour

JPEG_QUALITY = 80
_SHIFT = 4  # bits after the point in the pixels that OpenCV draws to


def annotated(
    make: Messages, frame: LocatedFrame, ends: Array, camera: Camera, stamp_ns: int, camera_frame: str = OPTICAL
) -> Any | None:
    """Return the image with expected landmarks, matched and unmatched edges; None where there is no image.

    ends: (L, 2, 3) of the landmarks in the map. camera_frame: the name of the camera's frame.
    """
    pixels = None if frame.image is None else _colour(frame.image)
    if pixels is None:
        return None
    pose = frame.located.estimate.pose_as_seen
    _, expected = predicted_lines(camera, pose, ends, frame.matches.visible)
    edges, matched = frame.located.edges, frame.matches.landmark >= 0
    known = np.isfinite(edges.ends_px).all(axis=(1, 2))
    _draw(pixels, expected, VISIBLE, 1)
    _draw(pixels, edges.ends_px[known & ~matched], UNMATCHED, 2)
    _draw(pixels, edges.ends_px[known & matched], MATCHED, 2)
    return make.compressed(stamp_ns, encode_image(pixels, ".jpg", JPEG_QUALITY), camera_frame)


def _colour(image: Image) -> NDArray[np.uint8] | None:
    """Return a copy (H, W, 3) to draw on, None where the file cannot be decoded."""
    if isinstance(image, bytes):
        decoded = decode(image, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        return None if decoded is None else np.asarray(decoded, dtype=np.uint8)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy(), dtype=np.uint8)


def _draw(pixels: NDArray[np.uint8], lines: Array, colour: Colour, width: int) -> None:
    """Draw lines (N, S, 2) in pixels."""
    red, green, blue, _ = colour
    strips = [np.round(line * 2**_SHIFT).astype(np.int32) for line in lines]
    cv2.polylines(pixels, strips, False, (blue, green, red), width, cv2.LINE_AA, _SHIFT)
