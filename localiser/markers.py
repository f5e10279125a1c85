"""Markers, ArUco and AprilTag: where they are in an image, and how their two upright sides are called.

A side is named on a map as `tag36h11:7:left`, of the marker 7 that side which is left of its middle as one looks at it.
In an image it is a number below -1, which is no index of a landmark.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.errors import InputError

DICTIONARIES = {
    name.removeprefix("DICT_").lower().replace("apriltag_", "tag"): getattr(cv2.aruco, name)
    for name in sorted(dir(cv2.aruco))
    if name.startswith("DICT_")
}
"""Every dictionary that OpenCV knows by its name here: `4x4_50`, `tag36h11`, …"""

SIDES = ("left", "right")
_NAME = re.compile(r"([a-z0-9_]+):(\d{1,5}):(left|right)")
_LEAST_PX = 8.0  # of an upright side


def sides_of_markers(image: NDArray[np.uint8], dictionary: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return both upright sides of the markers in a grey image as lines (S, 2, 2), lower end first, and numbers (S,).

    A marker that is not hung upright, to 45°, has none.
    """
    corners, numbers, _ = _detector(dictionary).detectMarkers(image)
    lines, codes = [], []
    for four, number in zip(corners, [] if numbers is None else np.ravel(numbers).tolist(), strict=True):
        top_left, top_right, bottom_right, bottom_left = np.asarray(four, dtype=np.float64).reshape(4, 2)
        for side, line in enumerate(((bottom_left, top_left), (bottom_right, top_right))):
            across, up = line[1] - line[0]
            if -up > max(abs(across), _LEAST_PX):
                lines.append(line)
                codes.append(_code(number, side))
    return np.array(lines).reshape(-1, 2, 2), np.array(codes, dtype=np.int64)


@cache
def _detector(dictionary: str) -> Any:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(DICTIONARIES[dictionary]), parameters)


def _code(number: int, side: int) -> int:
    return -2 - (2 * number + side)


def name_of(code: int, dictionary: str) -> str:
    """Return how a side is called on a map."""
    number, side = divmod(-2 - code, 2)
    return f"{dictionary}:{number}:{SIDES[side]}"


def code_of(name: object) -> tuple[int, str]:
    """Return the number of a side by its name, and the dictionary of its marker. Raises InputError."""
    found = _NAME.fullmatch(name) if isinstance(name, str) else None
    if found is None or found[1] not in DICTIONARIES:
        raise InputError(f"expected a side of a marker, such as tag36h11:7:left, found {name!r}", field="identity")
    return _code(int(found[2]), SIDES.index(found[3])), found[1]
