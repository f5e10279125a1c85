"""What looks for line segments in an image: the protocol of a detector, and those that are known by name.

`find_edges` takes any detector. One that a configuration (`edges.detector`) chooses by its name is registered first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Annotated, Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, Field

from localiser.camera import Camera
from localiser.edges.columns import SCALE_PX, GradientField, clutter, gradient_field
from localiser.edges.lines import LEAST_BLOCKS, Cells, Fitted, refined, rough_lines
from localiser.edges.types import Segments
from localiser.edges.views import ROWS_PER_BLOCK, Image, column_view, half_camera, halved, remap_tables
from localiser.geometry import Array, Indices
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
    gate_sigma: Annotated[float, Field(gt=0, le=10, description="allowed miss of the nadir point (sigmas)")] = 3.0
    tilt_sigma_deg: Annotated[float, Field(ge=0, le=10, description="error of the stated tilt (deg, 1 sigma)")] = 0.5
    roll_sigma_deg: Annotated[float, Field(ge=0, le=10, description="error of the stated roll (deg, 1 sigma)")] = 0.3
    markers: Annotated[
        str,
        AfterValidator(_dictionary),
        Field(description="ArUco or AprilTag markers that are looked for too, such as tag36h11; empty: none"),
    ] = ""
    plumb_sigma_deg: Annotated[float, Field(ge=0, le=5, description="how far edges are off plumb (deg, 1 sigma)")] = 0.3

    @property
    def mount_sigma_rad(self) -> Array:
        """How certain the stated tilt and roll (2,) are (rad, 1 sigma)."""
        return np.deg2rad([self.tilt_sigma_deg, self.roll_sigma_deg])


# -- nearly vertical lines, along the columns of the rectified image -------------------------------------------------

_SAME_EDGE_SHARE = 0.25  # where the gradient falls below this share of its mean, the edge has ended or is hidden
_BLURRED_STEEPNESS = 0.85  # of a gradient at twice the scale; sharp edges have half, those blurred by 7 px this
_SHARPEST = 0.1  # of all lines are as sharp as the camera can see; few are narrower, squeezed by a neighbour
_SOFT = 2.0  # a slope so many times wider than the sharpest ones is no edge
_IN_FOCUS_PX = float(np.hypot(SCALE_PX, 1.1))  # width of an edge's slope: lens, pixels and the remap blur it
_LEAST_HALVED_PX = 200  # images smaller than this are not halved: too little would remain


def columns(image: Image, camera: Camera, /, *, min_contrast: float) -> Segments:
    """Return the nearly vertical segments of a grey image (H, W) by searching the columns of its rectified view.

    min_contrast: faintest edge that counts, as a fraction of its sides' brightness.
    """
    field = gradient_field(image, camera)
    rough, cells = rough_lines(field)
    fitted = refined(rough, cells, field)
    kept, top, bottom = _significant(fitted, cells, field, min_contrast)
    if min(image.shape) >= _LEAST_HALVED_PX and _is_blurred(fitted, kept, cells, field):
        # There a blurred edge is a sharp one.
        found = columns(halved(image), half_camera(camera), min_contrast=min_contrast)
        sigmas_px = 2 * found.sigma_px, 2 * found.shift_sigma_px
        return Segments(2 * found.ends_px + 0.5, 2 * found.support_px + 0.5, *sigmas_px, found.polarity)
    fit, view = fitted.fit.take(kept), column_view(camera)
    reach = np.sqrt(fit.spread / fit.weight)
    points = np.stack([bottom[kept] - 0.5, top[kept] - 0.5, fit.x + reach, fit.x - reach], axis=1)
    column = fit.y[:, None] + fit.slope[:, None] * (points - fit.x[:, None])
    upright = view.upright(column, points * ROWS_PER_BLOCK + (ROWS_PER_BLOCK - 1) / 2)
    ideal_px = camera.ideal.pixels_from_upright(upright)
    # How many pixels, across an edge, one column is wide.
    cos_lean = np.cos(np.arctan(np.sin(camera.mount.tilt_rad) * view.tangent(fit.y)))
    to_px = view.depth(fit.x * ROWS_PER_BLOCK) * cos_lean * camera.focal_px / view.columns_per_tangent
    shift_sigma_px = to_px * np.hypot(fitted.shift[kept] * _blur(fitted, kept, cells), fitted.clipped[kept])
    sigmas_px = to_px * np.sqrt(2 / fit.weight), shift_sigma_px
    return Segments(ideal_px[:, :2], ideal_px[:, 2:], *sigmas_px, cells.polarity[kept])


def _is_blurred(fitted: Fitted, kept: Indices, cells: Cells, field: GradientField) -> bool:
    """Return whether most edges are as steep at twice the scale: blurred by some 7 px of motion, or 2.4 px of lens."""
    at_coarse = cells.sampled(field.coarse, fitted.fit.at(cells.groups.of, cells.row))[0]
    coarse, fine = (cells.mean(height)[kept] for height in (at_coarse, fitted.height))
    return len(kept) > 0 and float(np.median(coarse / fine)) > _BLURRED_STEEPNESS


def _significant(
    fitted: Fitted, cells: Cells, field: GradientField, min_contrast: float
) -> tuple[Indices, Array, Array]:
    """Return which lines are no accident of noise or texture, and where all lines (G,) begin and end, in blocks."""
    groups, line = cells.groups, cells.groups.of
    faintest = np.maximum(2.0, _SAME_EDGE_SHARE * cells.mean(fitted.height)[line])
    on = cells.in_chain & fitted.on_line & (fitted.height > faintest)
    column = np.rint(fitted.fit.at(line, cells.row)).astype(np.int64).clip(0, field.fine.shape[1] - 1)
    blocks = groups.sum(on)
    score = groups.sum(on * fitted.height / clutter(field.change[cells.row, column])) / np.sqrt(np.maximum(blocks, 1))
    # Noise alone exceeds this, in sigmas, less than once in an image: tests · exp(-z²/2) = 1. Tested are all runs of
    # blocks in all columns, leaning left, right or not.
    rows, width = field.fine.shape
    least = float(np.sqrt(2 * np.log(3 * width * rows**2 / 2)))
    kept = (blocks >= LEAST_BLOCKS) & (score > least) & (fitted.contrast >= min_contrast)
    if kept.any():  # lines that are far wider than the sharpest tenth of them are shading, or a shadow
        widest = np.sort((fitted.width + 2 * fitted.width_sigma)[kept])
        sharp = max(float(widest[int(_SHARPEST * len(widest))]), SCALE_PX)
        kept &= fitted.width - 2 * fitted.width_sigma <= _SOFT * sharp
    top, bottom = _extent(fitted.height, on, cells)
    return np.flatnonzero(kept), top, bottom


def _blur(fitted: Fitted, kept: Indices, cells: Cells) -> float:
    """Return by how much more than in focus something beside a line moves it, over what two scales tell: 1 in focus."""
    if len(kept) == 0:
        return 1.0
    order = np.argsort(fitted.width[kept])
    blocks = np.cumsum(cells.blocks[kept][order])
    median = float(fitted.width[kept][order][np.searchsorted(blocks, blocks[-1] / 2)])
    return max(median / _IN_FOCUS_PX, 1.0) ** 2


def _extent(height: Array, on: NDArray[np.bool_], cells: Cells) -> tuple[Array, Array]:
    """Return where (G,) lines begin and end, in blocks from the top of the rectified image.

    The gradient of a block that the edge covers in part is lower than that of the next one inwards, which tells the
    part. Both the last block that counts and the one beyond may be covered so.
    """
    line, index = cells.groups.of, np.flatnonzero(on)
    first, last = np.zeros((2, cells.groups.count), dtype=np.int64)
    first[line[index[::-1]]], last[line[index]] = index[::-1], index  # of several values the last one stays

    def beside(end: Indices, by: int) -> Array:
        at = (end + by).clip(0, len(height) - 1)
        return np.where((at == end + by) & (line[at] == line[end]), height[at], 0.0)

    def covered(end: Indices, outwards: int) -> Array:
        inner = np.maximum(beside(end, -outwards), 1e-6)
        return np.asarray((height[end] / inner).clip(0, 1) + (beside(end, outwards) / inner).clip(0, 1))

    return cells.row[first] + 1 - covered(first, -1), cells.row[last] + covered(last, 1)


# -- lines at any angle: LSD, and Canny with Hough's transform as the paper has it ------------------------------------

LSD_SIGMA_PX = 0.35  # error of an end of an LSD segment across the line, measured against exact edges
LSD_SHIFT_PX = 0.125
"""OpenCV divides positions in LSD's image of scale 0.8 by 0.8, without shifting for the centres of the pixels:
(x + 1/2) / 0.8 instead of (x + 1) / 0.8 - 1/2 for a gradient between x and x + 1."""
HOUGH_SIGMA_PX = 0.7  # error of an end of a Hough segment across the line: its points are whole pixels
_LARGEST_GROWTH = 2.0  # limit of the ideal image's size over the taken one's, for wide lenses
_MARGIN_PX = 3  # pixels of the ideal image that are closer than this to one without content are not used
_BORDER_SHARE = 0.5  # a segment of which more runs along the border of the field of view is that border


def lsd(image: Image, camera: Camera, /) -> Segments:
    """Return the segments of a grey image (H, W) by the line segment detector of von Gioi et al. (2010)."""

    def lines_of(image: Image) -> Array:
        found = cv2.createLineSegmentDetector().detect(image)[0] if min(image.shape) >= 3 else None
        return _lines(found) + LSD_SHIFT_PX

    return on_ideal_image(image, camera, lines_of, LSD_SIGMA_PX)


def hough(image: Image, camera: Camera, /) -> Segments:
    """Return the segments of a grey image (H, W) by Canny's edges and Hough's transform, as the paper does."""

    def lines_of(image: Image) -> Array:
        canny = cv2.Canny(cv2.GaussianBlur(image, (0, 0), 1.0), 40, 100)
        return _lines(cv2.HoughLinesP(canny, 1, np.pi / 720, threshold=25, minLineLength=20, maxLineGap=4))

    return on_ideal_image(image, camera, lines_of, HOUGH_SIGMA_PX)


def _lines(found: object) -> Array:
    """Return lines (S, 4) of what OpenCV returns: None, (S, 1, 4) or (S, 4), depending on its version."""
    return np.zeros((0, 4)) if found is None else np.asarray(found, dtype=np.float64).reshape(-1, 4)


def segments_of_lines(lines: Array, camera: Camera, sigma_px: float) -> Segments:
    """Return lines (S, 4) of the image as taken as segments whose ends err by sigma."""
    ends = camera.ideal.pixels_from_image(camera.image_from_pixels(lines.reshape(-1, 2, 2)))
    return Segments.of_ends(ends, sigma_px, camera.mount.roll_rad)


def on_ideal_image(image: Image, camera: Camera, lines_of: Callable[[Image], Array], sigma_px: float) -> Segments:
    """Return the segments that a detector finds where lines are straight, in undistorted pixels."""
    if not camera.is_distorted:
        return segments_of_lines(lines_of(image), camera, sigma_px)
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


DETECTORS.update(columns=partial(columns, min_contrast=EdgeParameters().min_contrast), lsd=lsd, hough=hough)
