"""Detect vertical edges by a search along the columns of a rectified image.

All vertical edges meet in the nadir point, so one remap that removes lens distortion, tilt and roll makes columns of
them. Blocks of a few rows are averaged to one row, which removes most of the noise. The horizontal gradient of these
rows is searched for peaks that continue from block to block.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges.views import ROWS_AT_ONCE, ROWS_PER_BLOCK, Image, column_view
from localiser.geometry import Array
from localiser.geometry.compiled import compiled

SCALE_PX = 1.0  # the image is filtered by the derivative of a Gaussian of this width: edges 3 px apart stay apart
ALONG = np.array([1.0, 2.0, 2.0, 2.0, 1.0]) / 8  # weights of the blocks in which peaks are looked for
PEAK_SIGMA = 3.0  # least height of a peak over the noise; the chain of peaks is judged as a whole afterwards
_LEAST_NOISE_GREY = 1 / np.sqrt(12.0)  # rounding to 8 bits alone is as noisy as this
_CLUTTER_BLOCKS, _CLUTTER_COLUMNS = 5, 17  # surroundings that tell how much texture an edge must stand out from
_CLUTTER_WEIGHT = 6.0  # texture is no white noise: it goes on from block to block, so that averaging removes less of it
_CHANGE_OF_NOISE = (3 - np.sqrt(3.0)) / np.sqrt(np.pi)
"""Mean of the smaller of two neighbouring differences of white noise of sigma 1: min = |x| + |y| - max."""


_OFFSETS = np.arange(-np.ceil(3.5 * SCALE_PX), np.ceil(3.5 * SCALE_PX) + 1)
_DERIVATIVE = _OFFSETS * np.exp(-(_OFFSETS**2) / (2 * SCALE_PX**2))
KERNEL = np.asarray(_DERIVATIVE / (_DERIVATIVE @ _OFFSETS), dtype=np.float32)
"""The derivative of a Gaussian (K,), such that a ramp of 1 grey level per px gives 1."""


@dataclass(frozen=True, slots=True, eq=False)
class GradientField:
    """Horizontal gradient of a rectified image, averaged over blocks of rows: (B, W), in units of its noise.

    fine: at `SCALE_PX`. smooth: the same averaged over neighbouring blocks. coarse: at twice the scale.
    change: mean size of what changes both from the block above and to the one below nearby, noise and texture.
    inside: whether both neighbours in the row are seen too. noise_grey: the noise's sigma (grey levels per px).
    smooth_sigma: the noise's sigma in `smooth`. grey: the rectified image averaged over blocks (grey levels).
    """

    fine: NDArray[np.float32]
    smooth: NDArray[np.float32]
    coarse: NDArray[np.float32]
    change: NDArray[np.float32]
    inside: NDArray[np.bool_]
    noise_grey: float
    smooth_sigma: float
    grey: NDArray[np.float32]


def gradient_field(image: Image, camera: Camera) -> GradientField:
    """Return the gradient field of a grey image (H, W) of `camera`; 0 where the image has nothing to show."""
    grey, (unseen, inside, some) = column_view(camera).blocks(image), unseen_blocks(camera)
    fine = np.asarray(cv2.filter2D(grey, -1, KERNEL[None], borderType=cv2.BORDER_REPLICATE), dtype=np.float32)
    fine[unseen] = 0.0
    least = _LEAST_NOISE_GREY * float(np.linalg.norm(KERNEL)) / np.sqrt(ROWS_PER_BLOCK * ROWS_AT_ONCE)
    noise = max(_robust_sigma(fine, some), least)
    fine /= np.float32(noise)
    smooth = np.asarray(cv2.filter2D(fine, -1, ALONG[:, None], borderType=cv2.BORDER_CONSTANT), dtype=np.float32)
    # A Gaussian of scale √3 s on top of one of scale s makes one of scale 2 s.
    coarse = np.asarray(cv2.GaussianBlur(fine, (0, 1), sigmaX=np.sqrt(3.0) * SCALE_PX), dtype=np.float32)
    smooth_sigma = max(_robust_sigma(smooth, some), float(np.linalg.norm(ALONG)))
    return GradientField(fine, smooth, coarse, change_of(fine), inside, noise, smooth_sigma, grey)


def _robust_sigma(values: NDArray[np.float32], some: NDArray[np.int64]) -> float:
    """Return 1.48 times the median size, about 0, of some of the values (B, W)."""
    size = np.abs(values.ravel()[some])
    return 1.4826 * float(np.median(size)) if len(size) else 0.0


def change_of(fine: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return how much a gradient (B, W) changes nearby from block to block, on that side where it changes less."""
    change = np.zeros_like(fine)
    cv2.absdiff(fine[1:], fine[:-1], dst=change[1:])
    np.minimum(change[1:-1], change[2:], out=change[1:-1])
    return np.asarray(cv2.blur(change, (_CLUTTER_COLUMNS, _CLUTTER_BLOCKS)), dtype=np.float32)


def clutter(change: Array) -> Array:
    """Return the sigma (K,) of noise and texture where there is so much change (K,), 1 where there is only noise.

    Vertical edges do not change from block to block, texture does, and on both sides: where a sill or a beam ends an
    edge, it changes on one side only. Mean sizes, because a strong edge nearby is no texture.
    """
    excess = (change / _CHANGE_OF_NOISE) ** 2 - 1
    return np.asarray(np.sqrt(1 + _CLUTTER_WEIGHT * np.maximum(excess, 0)))


@lru_cache(maxsize=8)
def unseen_blocks(camera: Camera) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.int64]]:
    """Return (B, W) blocks with a gradient that touches the outside of the image: its border is not an edge.

    And (B, W) the others that have none beside them: a slope that the border cuts off has no top there. And the flat
    indices of every 17th of the others: neighbours say the same.
    """
    unseen = column_view(camera).tables[2]
    blocks = np.any(unseen.reshape(-1, ROWS_PER_BLOCK, unseen.shape[1]), axis=1).astype(np.uint8)
    reach = int(np.ceil(2 * SCALE_PX))
    blocks[:, : reach + 1] = blocks[:, -reach - 1 :] = 1
    unseen, beside = (cv2.dilate(blocks, np.ones((1, 2 * wide + 1), np.uint8)) > 0 for wide in (reach, reach + 1))
    return np.asarray(unseen), np.asarray(~beside), np.flatnonzero(~unseen)[::17]


def peaks_of(field: GradientField) -> tuple[NDArray[np.int64], Array, NDArray[np.int8], NDArray[np.int64]]:
    """Return block, sub-pixel position, polarity as in `Edges`, and chain (P,) of the peaks along rows, sorted by row.

    That is where the smoothed gradient is largest. A peak goes on from one in the block above when each is the other's
    nearest of its polarity, at most a column off.
    """
    (rows, width), smooth = field.smooth.shape, field.smooth.ravel()
    size, least = np.abs(smooth), np.float64(PEAK_SIGMA * field.smooth_sigma)
    # Row after row: none begins or ends with what can have a peak.
    is_peak = (size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:]) & (size[1:-1] > least) & field.inside.ravel()[1:-1]
    place = np.flatnonzero(is_peak) + 1
    row, column = np.divmod(place, width)
    polarity = np.sign(smooth[place]).astype(np.int8)
    left, here, right = (smooth[place + by].astype(np.float64) * polarity for by in (-1, 0, 1))
    position = column + (right - left) / (2 * (2 * here - left - right))
    who = np.full((rows + 2, width + 2), -1, dtype=np.int32)
    return row, position, polarity, compiled(links_loop)(row, column, position, polarity, who)


def links_loop(
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    position: Array,
    polarity: NDArray[np.int8],
    who: NDArray[np.int32],
) -> NDArray[np.int64]:
    """Return the chain (P,) of each peak, sorted by row; who: (B + 2, W + 2) of -1 to work in."""
    count = len(row)
    nearest = np.full((2, count), -1, np.int64)  # in the row above, and below
    for p in range(count):
        who[row[p] + 1, column[p] + 1] = p
    for p in range(count):
        for side in range(2):
            least = np.inf
            for by in range(-1, 2):
                other = who[row[p] + 2 * side, column[p] + 1 + by]
                if other >= 0 and polarity[other] == polarity[p] and abs(position[other] - position[p]) < least:
                    least, nearest[side, p] = abs(position[other] - position[p]), other
    chain, chains = np.empty(count, np.int64), 0
    for p in range(count):
        above = nearest[0, p]
        if above >= 0 and nearest[1, above] == p:
            chain[p] = chain[above]
        else:
            chain[p] = chains
            chains += 1
    return chain
