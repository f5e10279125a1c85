"""What looks for line segments in an image: the protocol of a detector, and the list of those that are known by name.

`find_edges` takes any detector. To choose one by its name in a configuration (`edges.detector`), register it:

    def mine(image, camera):
        return lines  # (S, 4): u, v of one end, u, v of the other, in pixels of the image

    edges = find_edges(image, camera, detector=mine)
    register("mine", mine)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, Field

from localiser.camera import Camera
from localiser.edges.types import Segments
from localiser.edges.views import Image, remap_tables
from localiser.geometry import Array
from localiser.markers import DICTIONARIES


class Detector(Protocol):
    """A function, or an object that is called, that finds straight line segments in a grey image."""

    def __call__(self, image: Image, camera: Camera, /) -> Segments | ArrayLike:
        """Return the segments of a grey image (H, W), uint8, that `camera` took; those that are not vertical too.

        Either lines (S, 4), S of them: the ends u1, v1, u2, v2 in pixels of the image as it was taken, in any order,
        taken to err by `END_SIGMA_PX` across the line. Or `Segments`, which state their errors, in undistorted pixels.
        """


DETECTORS: dict[str, Detector] = {}
"""All detectors that a configuration can name, by their names."""


def register(name: str, detector: Detector) -> None:
    """Make a detector known by a name for `edges.detector`. Raises ValueError when the name is taken."""
    if name in DETECTORS:
        raise ValueError(f"expected a new name of a detector, found {name!r}, which is taken")
    DETECTORS[name] = detector


def registered(name: str) -> str:
    """Return the name of a detector. Raises ValueError when there is none of that name."""
    if name not in DETECTORS:
        *others, last = (repr(known) for known in DETECTORS)
        raise ValueError(f"expected {', '.join(others)} or {last}")
    return name


# -- settings ---------------------------------------------------------------------------------------------------------


def _dictionary(name: str) -> str:
    if name and name not in DICTIONARIES:
        raise ValueError(f"expected one of {', '.join(DICTIONARIES)}, or nothing")
    return name


DetectorName = Annotated[
    str, AfterValidator(registered), Field(json_schema_extra=lambda schema: schema.update(enum=list(DETECTORS)))
]


@dataclass(frozen=True, slots=True)
class EdgeParameters:
    """How vertical edges are found in an image."""

    detector: Annotated[DetectorName, Field(description="what looks for segments in the image")] = "columns"
    half_resolution: Annotated[
        bool, Field(description="look for edges in the image at half its resolution, in half to two thirds of the time")
    ] = False
    min_length_px: Annotated[float, Field(gt=2, le=1000, description="shortest edge that counts (px)")] = 30.0
    min_contrast: Annotated[
        float, Field(ge=0, le=2, description="faintest edge that counts, as a fraction of the brightness of its sides")
    ] = 0.08
    gate_sigma: Annotated[
        float, Field(gt=0, le=10, description="how far a vertical edge may miss the nadir point (sigmas)")
    ] = 3.0
    tilt_sigma_deg: Annotated[
        float, Field(ge=0, le=10, description="how certain the camera's stated tilt is (deg, 1 sigma)")
    ] = 0.5
    roll_sigma_deg: Annotated[
        float, Field(ge=0, le=10, description="how certain the camera's stated roll is (deg, 1 sigma)")
    ] = 0.3
    markers: Annotated[
        str,
        AfterValidator(_dictionary),
        Field(description="ArUco or AprilTag markers that are looked for too, such as tag36h11; empty: none"),
    ] = ""
    plumb_sigma_deg: Annotated[
        float, Field(ge=0, le=5, description="how far a building's vertical edges are from plumb (deg, 1 sigma)")
    ] = 0.3

    @property
    def mount_sigma_rad(self) -> Array:
        """How certain the stated tilt and roll (2,) are (rad, 1 sigma)."""
        return np.deg2rad([self.tilt_sigma_deg, self.roll_sigma_deg])


# -- lines at any angle: LSD, and Canny with Hough's transform as the paper has it ------------------------------------

LSD_SIGMA_PX = 0.35
"""Error of an end of an LSD segment across the line, measured against exact edges."""
LSD_SHIFT_PX = 0.125
"""OpenCV divides positions in LSD's image of scale 0.8 by 0.8, without shifting for the centres of the pixels:
(x + 1/2) / 0.8 instead of (x + 1) / 0.8 - 1/2 for a gradient between x and x + 1."""
HOUGH_SIGMA_PX = 0.7
"""Error of an end of a Hough segment across the line: its points are whole pixels."""
_LARGEST_GROWTH = 2.0
"""Limit of the ideal image's size over the taken one's; a wide lens sees what no sensible flat image can hold."""
_MARGIN_PX = 3
"""Pixels of the ideal image that are closer than this to one without content are not used."""
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
    """Return the segments that a detector finds where lines are straight, in undistorted pixels."""
    if not camera.is_distorted:
        ends = camera.ideal.pixels_from_image(camera.image_from_pixels(lines_of(image).reshape(-1, 2, 2)))
        return Segments.of_ends(ends, sigma_px, camera.mount.roll_rad)
    corner, map_1, map_2, seen = _ideal_tables(camera)
    straight = np.asarray(cv2.remap(image, map_1, map_2, cv2.INTER_LINEAR), dtype=np.uint8)
    ends = lines_of(straight).reshape(-1, 2, 2)
    # What runs along or outside the border of what is seen is that border.
    steps = np.linspace(0.0, 1.0, 17)[:, None]
    points = ends[:, None, 0] * (1 - steps) + ends[:, None, 1] * steps
    column, row = np.moveaxis(np.rint(points).astype(int), -1, 0)
    column, row = column.clip(0, seen.shape[1] - 1), row.clip(0, seen.shape[0] - 1)
    is_border = (seen[row, column] == 0).mean(axis=1) > _BORDER_SHARE
    return Segments.of_ends(ends[~is_border] + corner, sigma_px, camera.mount.roll_rad)


@lru_cache(maxsize=8)
def _ideal_tables(camera: Camera) -> tuple[Array, NDArray[np.int16], NDArray[np.uint16], Image]:
    """Return the corner (2,) of the ideal image that holds the whole field of view, its `cv2.remap`, and what is seen.

    The corner is in undistorted pixels. seen: (H, W), 0 where the taken image has nothing to show, or close to there.
    """
    border = camera.ideal.pixels_from_image(camera.image_from_pixels(camera.border_px().reshape(-1, 2)))
    size = np.array([camera.width, camera.height])
    slack = (_LARGEST_GROWTH - 1) / 2 * size
    left, top = np.floor(np.maximum(border.min(axis=0), -slack)).astype(int).tolist()
    right, bottom = np.ceil(np.minimum(border.max(axis=0), size - 1 + slack)).astype(int).tolist()
    ideal = replace(camera.ideal, cx=camera.cx - left, cy=camera.cy - top)
    map_1, map_2, unseen = remap_tables(ideal.image_from_pixels, (right - left + 1, bottom - top + 1), camera)
    around = np.ones((2 * _MARGIN_PX + 1, 2 * _MARGIN_PX + 1), np.uint8)
    seen = cv2.erode((~unseen).astype(np.uint8), around, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.array([camera.cx - ideal.cx, camera.cy - ideal.cy]), map_1, map_2, np.asarray(seen, dtype=np.uint8)
