"""The 2-D image view: the picture, what was found in it, and what the estimate expects in it."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from localiser import geometry
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.filter import Image
from localiser.geometry import Array
from localiser.view import palette

JPEG_QUALITY = 80
_FINE_STEPS = 129
"""Points at which a landmark's line is asked whether it is inside the image: a few pixels apart."""
_MEDIA_TYPES = {b"\xff\xd8": "image/jpeg", b"\x89P": "image/png"}


def picture(image: Image) -> rr.EncodedImage:
    """Return the image as a JPEG; bytes that are a file already are passed through."""
    if isinstance(image, bytes):
        return rr.EncodedImage(contents=image, media_type=_MEDIA_TYPES.get(image[:2]))
    _, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg")


def rejected(edges: Edges) -> rr.LineStrips2D:
    """Return the segments that were found and are not vertical edges."""
    return _lines(edges.rejected_px, palette.REJECTED, 0.8)


def vertical_edges(edges: Edges, matched: NDArray[np.bool_]) -> rr.LineStrips2D:
    """Return the vertical edges, coloured by whether they match (E,) a landmark; those without pixels are left out."""
    known = np.isfinite(edges.ends_px).all(axis=(1, 2))
    colours = np.where(matched[known, None], palette.MATCHED, palette.UNMATCHED).astype(np.uint8)
    return _lines(edges.ends_px[known], colours, 2.2)


def predicted(lines: Array) -> rr.LineStrips2D:
    """Return the lines (V, S, 2) at which the estimate expects landmarks."""
    return _lines(lines, palette.VISIBLE, 1.0)


def joins(edges: Edges, landmark: NDArray[np.int64], shown: NDArray[np.int64], lines: Array) -> rr.LineStrips2D:
    """Return a line from the middle of each matched edge to its landmark's prediction in the same pixel row.

    landmark: (E,) index or -1. shown: (V,) indices of the landmarks whose predicted lines (V, S, 2) are given.
    """
    line_of = {int(index): line for index, line in zip(shown, lines, strict=True)}
    pairs = [
        (middle, _point_in_row(line_of[int(index)], middle[1]))
        for middle, index in zip(edges.ends_px.mean(axis=1), landmark, strict=True)
        if int(index) in line_of and np.isfinite(middle).all()
    ]
    return _lines(np.array(pairs).reshape(-1, 2, 2), palette.JOIN, 2.2)


def predicted_lines(
    camera: Camera, pose: Array, ends: Array, visible: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], Array]:
    """Return indices (V,) of the landmarks that reach into the image from `pose`, and their image lines (V, S, 2).

    ends: (L, 2, 3) bottom and top in the map. visible: (L,) which to consider. Lines run upwards, bent by the lens:
    S is 2 for an ideal lens.
    """
    index = np.flatnonzero(visible)
    bottom, top = ends[index, 0], ends[index, 1]
    ahead = -geometry.robot_from_map(camera.pose_in_map(pose), bottom[:, [0, 2]])[:, 1]
    lowest, highest = _heights_in_image(camera, ahead)
    low, high = np.maximum(bottom[:, 1], lowest), np.minimum(top[:, 1], highest)
    seen = (ahead > 0) & (high > low)
    low, high = low[seen], high[seen]
    fine = _vertical_lines(camera, pose, bottom[seen], low, high, _FINE_STEPS)
    within = np.all((fine >= -0.5) & (fine <= np.array([camera.width, camera.height]) - 0.5), axis=-1)
    first, last = within.argmax(axis=1), _FINE_STEPS - 1 - within[:, ::-1].argmax(axis=1)
    # What leaves the image sideways is cut at the last point inside.
    shown, length = within.any(axis=1) & (last > first), (high - low) / (_FINE_STEPS - 1)
    low, high = low + first * length, low + last * length
    steps = 12 if camera.is_distorted else 2
    return index[seen][shown], _vertical_lines(camera, pose, bottom[seen][shown], low[shown], high[shown], steps)


def _vertical_lines(camera: Camera, pose: Array, feet: Array, low: Array, high: Array, steps: int) -> Array:
    """Return pixels (V, S, 2) of points over feet (V, 3) in the map, from the height `low` (V,) to `high` (V,)."""
    points = np.repeat(feet[:, None, :], steps, axis=1)
    points[:, :, 1] = np.linspace(low, high, steps, axis=-1)
    return camera.project(pose, points)


def _heights_in_image(camera: Camera, ahead: Array) -> tuple[Array, Array]:
    """Return the heights above the floor (L,) at the image's lower and upper border for points so far ahead.

    The inverse of e = (c y + s d) / (c d - s y), with y above the camera and d ahead of it. Clipping before the
    projection keeps the lens polynomial where it was calibrated.
    """
    s, c = np.sin(camera.mount.tilt_rad), np.cos(camera.mount.tilt_rad)
    _, _, e_bottom, e_top = camera.upright_bounds
    low, high = (ahead * (e * c - s) / (c + e * s) + camera.mount.height_m for e in (e_bottom, e_top))
    return np.asarray(low), np.asarray(high)


def _point_in_row(line: Array, v: float) -> Array:
    """Return the point (2,) of a line (S, 2), v falling along it, in pixel row v; its nearer end beyond the ends."""
    upside_down = line[::-1]
    return np.array([np.interp(v, upside_down[:, 1], upside_down[:, 0]), np.clip(v, line[-1, 1], line[0, 1])])


def _lines(strips: Array, colours: palette.Colour | NDArray[np.uint8], width: float) -> rr.LineStrips2D:
    return rr.LineStrips2D(strips.astype(np.float32), colors=colours, radii=rr.Radius.ui_points(width / 2))
