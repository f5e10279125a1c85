"""Landmarks and matched edges to look at: as markers for RViz and Foxglove, and drawn into the image."""

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
from localiser.storage.bags import MARKERS, OPTICAL, Messages, header
from localiser.view import MATCHED, UNMATCHED, VISIBLE, Colour

_LINES, _ADD, _DELETE = 5, 0, 2  # LINE_LIST, ADD and DELETE of visualization_msgs/Marker
JPEG_QUALITY = 80
_SHIFT = 4  # bits after the point in the pixels that OpenCV draws to
_MARKER = "visualization_msgs/msg/Marker"
_POST_M, _SIGHT_M = 0.03, 0.01


def landmark_markers(make: Messages, ends: Array, stamp_ns: int, frame: str) -> Any:
    """Return one marker: every landmark as an upright line between its ends (L, 2, 3) in the map."""
    lines = _lines(make, stamp_ns, frame, "landmarks", ends, VISIBLE, _POST_M)
    return make.make(MARKERS, markers=[lines])


def match_markers(make: Messages, found: LocatedFrame, ends: Array, camera: Camera, stamp_ns: int, frame: str) -> Any:
    """Return two markers: the landmarks that edges match, and lines to them from the camera. Without any, they go.

    ends: (L, 2, 3) of the landmarks. frame: the name of the map's.
    """
    landmark = found.matches.landmark
    seen = ends[np.unique(landmark[landmark >= 0])]
    x, z, _ = camera.pose_in_map(found.located.estimate.pose)
    here = np.broadcast_to([x, camera.mount.height_m, z], (len(seen), 3))
    sights = np.stack([here, seen.mean(axis=1)], axis=1)
    posts = _lines(make, stamp_ns, frame, "matched", seen, MATCHED, _POST_M)
    return make.make(MARKERS, markers=[posts, _lines(make, stamp_ns, frame, "sights", sights, MATCHED, _SIGHT_M)])


def _lines(make: Messages, stamp_ns: int, frame: str, name: str, ends: Array, colour: Colour, width_m: float) -> Any:
    """Return a marker of lines with these ends (N, 2, 3) in the map; one that deletes it where there are none."""
    red, green, blue, alpha = (value / 255 for value in colour)
    return make.make(
        _MARKER,
        header=header(stamp_ns, frame),
        ns=name,
        type=_LINES,
        action=_ADD if len(ends) else _DELETE,
        pose={"orientation": {"w": 1.0}},
        scale={"x": width_m},
        color={"r": red, "g": green, "b": blue, "a": alpha},
        points=make.points(ends.reshape(-1, 3)),
    )


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
