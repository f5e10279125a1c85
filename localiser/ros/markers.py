"""Landmarks and matched edges as visualization_msgs/MarkerArray, for RViz and Foxglove."""

from __future__ import annotations

from typing import Any

import numpy as np

from localiser.camera import Camera
from localiser.filter import LocatedFrame
from localiser.geometry import Array
from localiser.storage.bags import MARKERS, Messages, header
from localiser.view import MATCHED, VISIBLE, Colour

_LINES, _ADD, _DELETE = 5, 0, 2  # LINE_LIST, ADD and DELETE of visualization_msgs/Marker
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
