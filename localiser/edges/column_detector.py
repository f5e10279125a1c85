"""The detector along columns: it finds lines that are not due to chance, their ends, and handles blurred images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges.columns import SCALE_PX, GradientField, clutter, gradient_field, linked, peaks_of
from localiser.edges.lines import LEAST_BLOCKS, Cells, Fitted, refined, rough_lines
from localiser.edges.types import Segments
from localiser.edges.views import ROWS_PER_BLOCK, Image, column_view, half_camera, halved
from localiser.geometry import Array

_SAME_EDGE_SHARE = 0.25
"""Where the gradient falls below this share of its mean, the edge has ended or is hidden."""
_BLURRED_STEEPNESS = 0.85
"""Of a sharp edge, the gradient at twice the scale is half as steep; of one blurred by 7 px of motion, this."""
_SHARPEST = 0.1
"""The fraction of lines that are as sharp as the camera can see; a few are narrower, squeezed by a neighbour."""
_SOFT = 2.0
"""A slope so many times wider than the sharpest ones is no edge."""
_IN_FOCUS_PX = float(np.hypot(SCALE_PX, 1.1))
"""Width of the slope of an edge, at `SCALE_PX`, in an image that is in focus: lens, pixels and the remap blur it."""
_LEAST_HALVED_PX = 200
"""Images smaller than this are not halved: too little would remain."""


@dataclass(frozen=True, slots=True)
class Columns:
    """The detector `columns`. min_contrast: faintest edge that counts, as a fraction of its sides' brightness."""

    min_contrast: float

    def __call__(self, image: Image, camera: Camera, /) -> Segments:
        """Return the nearly vertical segments of a grey image (H, W) by searching the columns of its rectified view."""
        field = gradient_field(image, camera)
        peaks = peaks_of(field)
        rough, cells = rough_lines(peaks, linked(peaks, field.fine.shape), len(field.fine))
        fitted = refined(rough, cells, field)
        kept, top, bottom = _significant(fitted, cells, field, self.min_contrast)
        if min(image.shape) >= _LEAST_HALVED_PX and _is_blurred(fitted, kept, cells, field):
            # There a blurred edge is a sharp one.
            found = self(halved(image), half_camera(camera))
            sigmas_px = 2 * found.sigma_px, 2 * found.shift_sigma_px
            return Segments(2 * found.ends_px + 0.5, 2 * found.support_px + 0.5, *sigmas_px, found.polarity)
        fit, view = fitted.fit.take(kept), column_view(camera)
        reach = np.sqrt(fit.spread / fit.weight)
        points = np.stack([bottom[kept] - 0.5, top[kept] - 0.5, fit.x + reach, fit.x - reach], axis=1)
        column = fit.y[:, None] + fit.slope[:, None] * (points - fit.x[:, None])
        upright = view.upright(column, points * ROWS_PER_BLOCK + (ROWS_PER_BLOCK - 1) / 2)
        ideal_px = camera.ideal.pixels_from_upright(upright)
        to_px = view.pixels_per_column(fit.y, fit.x * ROWS_PER_BLOCK)
        return Segments(
            ends_px=ideal_px[:, :2],
            support_px=ideal_px[:, 2:],
            sigma_px=to_px * np.sqrt(2 / fit.weight),
            shift_sigma_px=to_px * np.hypot(fitted.shift[kept] * _blur(fitted, kept, cells), fitted.clipped[kept]),
            polarity=cells.polarity[kept],
        )


def _is_blurred(fitted: Fitted, kept: NDArray[np.int64], cells: Cells, field: GradientField) -> bool:
    """Return whether most edges are as steep at twice the scale: blurred by some 7 px of motion, or 2.4 px of lens.

    A sharp step is half as steep there. One so wide shows two peaks at the fine scale, at either end of its slope.
    """
    groups = cells.groups
    at_coarse = cells.sampled(field.coarse, fitted.fit.at(groups.of, cells.row))[0]
    coarse, fine = (cells.mean(height)[kept] for height in (at_coarse, fitted.height))
    return len(kept) > 0 and float(np.median(coarse / fine)) > _BLURRED_STEEPNESS


def _significant(
    fitted: Fitted, cells: Cells, field: GradientField, min_contrast: float
) -> tuple[NDArray[np.int64], Array, Array]:
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
    kept &= ~_is_soft(fitted, kept)
    top, bottom = _extent(fitted.height, on, cells)
    return np.flatnonzero(kept), top, bottom


def _blur(fitted: Fitted, kept: NDArray[np.int64], cells: Cells) -> float:
    """Return by how much more than in focus something beside a line moves it, over what two scales tell: 1 in focus.

    In a blurred image both scales see wide slopes, so that they differ less. Slopes grow with the square of the width.
    """
    if len(kept) == 0:
        return 1.0
    order = np.argsort(fitted.width[kept])
    blocks = np.cumsum(cells.blocks[kept][order])
    median = float(fitted.width[kept][order][np.searchsorted(blocks, blocks[-1] / 2)])
    return max(median / _IN_FOCUS_PX, 1.0) ** 2


def _is_soft(fitted: Fitted, kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which lines (G,) are far wider than the camera blurs a step: shading of something round, or a shadow.

    How wide that is the sharpest tenth of the lines that are kept (G,) tells.
    """
    if not kept.any():
        return np.zeros(len(kept), dtype=np.bool_)
    widest, narrowest = fitted.width + 2 * fitted.width_sigma, fitted.width - 2 * fitted.width_sigma
    among = widest[kept]
    sharp = max(float(np.partition(among, int(_SHARPEST * len(among)))[int(_SHARPEST * len(among))]), SCALE_PX)
    return np.asarray(narrowest > _SOFT * sharp)


def _extent(height: Array, on: NDArray[np.bool_], cells: Cells) -> tuple[Array, Array]:
    """Return where (G,) lines begin and end, in blocks from the top of the rectified image.

    The gradient of a block that the edge covers in part is as much lower; compared with the next one inwards it tells
    which part. Both the last block that counts and the one beyond may be covered in part.
    """
    groups, index = cells.groups, np.arange(len(on))
    first, last = groups.lowest(index, on), groups.highest(index, on)
    first_cell, last_cell = (np.where(np.isfinite(end), end, 0).astype(np.int64) for end in (first, last))

    def covered(end: NDArray[np.int64], outwards: int) -> Array:
        inner = np.maximum(_neighbour(height, groups.of, end, -outwards), 1e-6)
        beyond = _neighbour(height, groups.of, end, outwards)
        return np.asarray((height[end] / inner).clip(0, 1) + (beyond / inner).clip(0, 1))

    if len(on) == 0:
        return np.zeros(0), np.zeros(0)
    return cells.row[first_cell] + 1 - covered(first_cell, -1), cells.row[last_cell] + covered(last_cell, 1)


def _neighbour(values: Array, group: NDArray[np.int64], cell: NDArray[np.int64], by: int) -> Array:
    """Return the value (G,) of the cell one above or below, 0 where that is none of the same line."""
    at = cell + by
    inside = at.clip(0, len(values) - 1)
    return np.where((at == inside) & (group[inside] == group[cell]), values[inside], 0.0)
