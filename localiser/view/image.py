"""The 2-D image view: the picture, what was found in it, and what the estimate expects in it."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from localiser.edges import Edges
from localiser.filter import Image
from localiser.geometry import Array
from localiser.view import palette

JPEG_QUALITY = 80
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


def _point_in_row(line: Array, v: float) -> Array:
    """Return the point (2,) of a line (S, 2), v falling along it, in pixel row v; its nearer end beyond the ends."""
    upside_down = line[::-1]
    return np.array([np.interp(v, upside_down[:, 1], upside_down[:, 0]), np.clip(v, line[-1, 1], line[0, 1])])


def _lines(strips: Array, colours: palette.Colour | NDArray[np.uint8], width: float) -> rr.LineStrips2D:
    return rr.LineStrips2D(strips.astype(np.float32), colors=colours, radii=rr.Radius.ui_points(width / 2))
