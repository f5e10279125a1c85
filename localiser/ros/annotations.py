"""Edges and expected landmarks as Foxglove's ImageAnnotations: lines that its image panel draws over the image.

The image itself is not sent again, as for the drawn one in `picture`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from localiser.camera import Camera
from localiser.filter import LocatedFrame
from localiser.geometry import Array
from localiser.landmarks import predicted_lines
from localiser.storage.bags import ANNOTATIONS, Messages, header
from localiser.view import MATCHED, UNMATCHED, VISIBLE, Colour

_LINE_LIST = 4
_PIXEL_CENTRE = 0.5  # the origin is the corner of the top-left pixel there, and its centre here


def drawn_lines(make: Messages, frame: LocatedFrame, ends: Array, camera: Camera, stamp_ns: int) -> Any:
    """Return expected landmarks, unmatched and matched edges of an image. ends: (L, 2, 3) of the landmarks."""
    _, expected = predicted_lines(camera, frame.located.estimate.pose_as_seen, ends, frame.matches.visible)
    edges, matched = frame.located.edges.ends_px, frame.matches.landmark >= 0
    known = np.isfinite(edges).all(axis=(1, 2))
    expected_px = np.stack([expected[:, :-1], expected[:, 1:]], axis=2).reshape(-1, 2)  # each piece of each line
    groups = [
        (expected_px, VISIBLE, 1.0),
        (edges[known & ~matched].reshape(-1, 2), UNMATCHED, 2.0),
        (edges[known & matched].reshape(-1, 2), MATCHED, 2.0),
    ]
    return make.make(ANNOTATIONS, points=[_lines(make, stamp_ns, *group) for group in groups if len(group[0])])


def _lines(make: Messages, stamp_ns: int, points_px: Array, colour: Colour, thickness_px: float) -> Any:
    """Return lines between every two of the points (2 N, 2)."""
    point = make.store.types["foxglove_msgs/msg/Point2"]
    return make.make(
        "foxglove_msgs/msg/PointsAnnotation",
        timestamp=header(stamp_ns, "")["stamp"],
        type=_LINE_LIST,
        points=[point(x=x, y=y) for x, y in (points_px[np.isfinite(points_px).all(axis=1)] + _PIXEL_CENTRE).tolist()],
        outline_color=dict(zip("rgba", (value / 255 for value in colour), strict=True)),
        thickness=thickness_px,
    )
