"""Detectors of lines anywhere in the image, at any angle: LSD, and Canny with Hough's transform as the paper has it."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from localiser.camera import Camera
from localiser.edges.segments import Segments
from localiser.edges.undistort import Image, ideal_camera, ideal_view
from localiser.geometry import Array

LSD_SIGMA_PX = 0.35
"""Error of an end of an LSD segment across the line, measured against exact edges."""
LSD_SHIFT_PX = 0.125
"""OpenCV divides positions in LSD's image of scale 0.8 by 0.8, without shifting for the centres of the pixels:
(x + 1/2) / 0.8 instead of (x + 1) / 0.8 - 1/2 for a gradient between x and x + 1."""
HOUGH_SIGMA_PX = 0.7
"""Error of an end of a Hough segment across the line: its points are whole pixels."""
_BORDER_SHARE = 0.5
"""A segment is the border of the field of view if more than this fraction of it runs along that border."""


def lsd(image: Image, camera: Camera, /) -> Segments:
    """Return the segments of a grey image (H, W) by the line segment detector of von Gioi et al. (2010)."""
    return on_ideal_image(image, camera, _lsd_lines, LSD_SIGMA_PX)


def hough(image: Image, camera: Camera, /) -> Segments:
    """Return the segments of a grey image (H, W) by Canny's edges and Hough's transform, as the paper does."""
    return on_ideal_image(image, camera, _hough_lines, HOUGH_SIGMA_PX)


def _lsd_lines(image: Image) -> Array:
    if min(image.shape) < 3:
        return np.zeros((0, 4))
    return _lines(cv2.createLineSegmentDetector().detect(image)[0]) + LSD_SHIFT_PX


def _hough_lines(image: Image) -> Array:
    canny = cv2.Canny(cv2.GaussianBlur(image, (0, 0), 1.0), 40, 100)
    return _lines(cv2.HoughLinesP(canny, 1, np.pi / 720, threshold=25, minLineLength=20, maxLineGap=4))


def _lines(found: object) -> Array:
    """Return lines (S, 4) of what OpenCV returns: None, (S, 1, 4) or (S, 4), depending on its version."""
    return np.zeros((0, 4)) if found is None else np.asarray(found, dtype=np.float64).reshape(-1, 4)


def on_ideal_image(image: Image, camera: Camera, lines_of: Callable[[Image], Array], sigma_px: float) -> Segments:
    """Return the segments that a detector finds where lines are straight, in undistorted pixels.

    Where the lens bends lines negligibly the taken image is searched and the ends are undistorted.
    """
    view = ideal_view(camera)
    if view is None:
        taken = lines_of(image).reshape(-1, 2, 2)
        ends = ideal_camera(camera).pixels_from_image(camera.image_from_pixels(taken))
    else:
        found = lines_of(view.of(image)).reshape(-1, 2, 2)
        found = found[~_is_border(found, view.seen)]
        ends = found + np.array([camera.cx - view.camera.cx, camera.cy - view.camera.cy])
    return Segments.of_ends(ends, sigma_px)


def _is_border(ends_px: Array, seen: Image) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return (S,) whether segments run along or outside the border of what is `seen` (H, W)."""
    steps = np.linspace(0.0, 1.0, 17)[:, None]
    points = ends_px[:, None, 0] * (1 - steps) + ends_px[:, None, 1] * steps
    column, row = np.moveaxis(np.rint(points).astype(int), -1, 0)
    column, row = column.clip(0, seen.shape[1] - 1), row.clip(0, seen.shape[0] - 1)
    return np.asarray((seen[row, column] == 0).mean(axis=1) > _BORDER_SHARE)
