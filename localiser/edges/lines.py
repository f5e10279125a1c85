"""Straight lines through chains of gradient peaks: sub-pixel position, its sigma, and extent, for all chains at once.

A line is column = y + slope · (row - x) in blocks and columns of the rectified image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from localiser.edges.columns import ALONG, KERNEL, SCALE_PX, GradientField, peaks_of
from localiser.geometry import Array, Indices
from localiser.geometry.compiled import compiled


class LineFit(NamedTuple):
    """Weighted straight lines y(x), one per group (G,): through (x, y) with `slope`.

    weight: Σw. spread: Σw (x - mean x)². With w = 1/σ² the variance of y is 1/weight, that of slope 1/spread.
    """

    x: Array
    y: Array
    slope: Array
    weight: Array
    spread: Array

    def at(self, group: Indices, x: Array | Indices) -> Array:
        """Return y (K,) of the lines of groups (K,) at x (K,)."""
        return np.asarray(self.y[group] + self.slope[group] * (x - self.x[group]))

    def take(self, index: Indices) -> LineFit:
        """Return the lines of some groups."""
        return LineFit._make(column[index] for column in self)


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Which group, 0 … count - 1, each of K values belongs to."""

    of: Indices
    count: int

    def sum(self, values: Array | NDArray[np.bool_]) -> Array:
        """Return the sum (G,) of values (K,) of each group."""
        return np.asarray(np.bincount(self.of, values, self.count), dtype=np.float64)

    def line(self, x: Array | Indices, y: Array, weight: Array) -> LineFit:
        """Return the weighted least-squares line of each group through (x, y) (K,)."""
        total = np.maximum(self.sum(weight), 1e-12)
        mean_x, mean_y = self.sum(weight * x) / total, self.sum(weight * y) / total
        from_mean = x - mean_x[self.of]
        weighted = weight * from_mean
        spread = self.sum(weighted * from_mean)
        return LineFit(mean_x, mean_y, self.sum(weighted * y) / np.maximum(spread, 1e-12), total, spread)


LEAST_BLOCKS = 3
_PRIOR_BLOCKS = 4.0  # as how many blocks of residuals the predicted noise counts, when a line's own scatter is judged
_TUKEY = 4.0  # blocks further from the line than this many sigmas have no say
_SAMPLING_SIGMA_PX = {1: 0.03, 2: 0.01}
"""Error by pixels and by the remap, at `SCALE_PX` and at twice that: tables hold 1/32 px, and an edge that is sharper
than a pixel has none of its own scale to be interpolated."""
_WHITE_GREY = 250.0
_BESIDE_PX = 3.0
_CLIPPED_SIGMA_PX = 1 / np.sqrt(12.0)
"""Where the lighter side is clipped, the fraction of the edge's pixel that it covers is unknown, and it changes along
the edge with the light."""
_MARGIN_BLOCKS = 2
_ALONG_VARIANCE = float(ALONG @ np.arange(-2.0, 3.0) ** 2)  # of the average over neighbouring blocks
_WIDTH_ITERATIONS = 4
_LEAST_WIDTH_PX = 0.5 * SCALE_PX

_KERNEL = KERNEL / np.linalg.norm(KERNEL)
_FIRST, _SECOND = np.array([0.5, 0.0, -0.5]), np.array([-1.0, 2.0, -1.0])
_WIDER = cv2.getGaussianKernel(15, np.sqrt(3.0) * SCALE_PX).ravel()
_STEEPNESS_SIGMA = float(np.linalg.norm(np.convolve(_KERNEL, _FIRST)))
_CURVATURE_SIGMA = float(np.linalg.norm(np.convolve(_KERNEL, _SECOND)) * np.linalg.norm(ALONG))
_COARSE_STEEPNESS_SIGMA = float(np.linalg.norm(np.convolve(np.convolve(_KERNEL, _WIDER), _FIRST)))
_COARSE_CURVATURE_SIGMA = float(np.linalg.norm(np.convolve(np.convolve(_KERNEL, _WIDER), _SECOND)))
"""Noise of the gradient's first and second difference along a row, in units of the gradient's own."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """All blocks that lines cross, K of them, from two above the chain's first to two below its last.

    in_chain: (K,) whether between those two. blocks: (G,) how many of each line are. polarity: (G,) of the lines.
    """

    groups: Groups
    row: Indices
    in_chain: NDArray[np.bool_]
    blocks: Array
    polarity: NDArray[np.int8]

    def mean(self, values: Array) -> Array:
        """Return the mean (G,) of values (K,) over the blocks of each chain."""
        return self.groups.sum(values * self.in_chain) / self.blocks

    def sampled(self, values: NDArray[np.float32], column: Array) -> tuple[Array, Array, Array]:
        """Return a field's height, steepness and negative curvature along its row at columns (K,), as at a peak."""
        return compiled(samples_loop)(values, self.row, column, self.polarity[self.groups.of])


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Refined lines, G of them.

    height: (K,) gradient at each of their blocks. on_line: (K,) whether its peak lies on the line. width, width_sigma:
    (G,) columns, of the Gaussian that would blur a step to this gradient; that of `SCALE_PX` is part of it. shift: (G,)
    columns by which something on one side may have moved the line, one end more than the other. clipped: (G,) the same
    for the white beside the line. contrast: (G,) by how much the sides differ, over their mean brightness; inf where
    the lighter one is overexposed, because it may be any brighter.
    """

    fit: LineFit
    height: Array
    on_line: NDArray[np.bool_]
    width: Array
    width_sigma: Array
    shift: Array
    clipped: Array
    contrast: Array


def rough_lines(field: GradientField) -> tuple[LineFit, Cells]:
    """Return robust lines through the peaks of each chain that is long enough, and which of the blocks they cross."""
    row, position, sign, chain = peaks_of(field)
    groups = Groups(chain, int(chain.max(initial=-1)) + 1)
    weight = np.ones(len(chain))
    for _ in range(3):
        fit = groups.line(row, position, weight)
        weight = 1 / (1 + ((position - fit.at(chain, row)) / 0.5) ** 2)
    first, last = np.empty((2, groups.count), dtype=np.int64)
    polarity = np.empty(groups.count, dtype=np.int8)
    # Of several values the last one stays.
    first[chain[::-1]], last[chain], polarity[chain] = row[::-1], row, sign
    long = np.flatnonzero(last - first >= LEAST_BLOCKS - 1)
    first, last = first[long], last[long]
    top = np.maximum(first - _MARGIN_BLOCKS, 0)
    size = np.minimum(last + _MARGIN_BLOCKS, len(field.fine) - 1) - top + 1
    line = np.repeat(np.arange(len(size)), size)
    row = np.arange(len(line)) - (np.cumsum(size) - size - top)[line]
    in_chain, blocks = (row >= first[line]) & (row <= last[line]), (last - first + 1).astype(np.float64)
    return fit.take(long), Cells(Groups(line, len(size)), row, in_chain, blocks, polarity[long])


def _steady(curvature: Array, noise: float, cells: Cells) -> Array:
    """Return the curvature (K,) of each block, drawn towards its line's mean as far as it varies by noise only."""
    line = cells.groups.of
    mean = cells.mean(curvature)
    variance = cells.mean((curvature - mean[line]) ** 2)
    real = np.maximum(variance - noise**2, 0) / np.maximum(variance, 1e-9)
    return np.maximum(mean[line] + real[line] * (curvature - mean[line]), 0.05 * noise)


def refined(fit: LineFit, cells: Cells, field: GradientField) -> Fitted:
    """Return the lines that the gradient's peaks lie on, by Gauss-Newton steps with Tukey's weights.

    At a peak the steepness is 0; near it, it tells how far off the peak is: steepness / curvature.
    """
    groups, line = cells.groups, cells.groups.of
    robust = cells.in_chain.astype(np.float64)
    column = fit.at(line, cells.row)
    curvature = _steady(cells.sampled(field.smooth, column)[2], _CURVATURE_SIGMA, cells)
    weight = (curvature / _STEEPNESS_SIGMA) ** 2
    for _ in range(2):
        height, steepness, _ = cells.sampled(field.fine, column)
        target = column + (steepness / curvature).clip(-2, 2)
        fit = groups.line(cells.row, target, weight * robust)
        column = fit.at(line, cells.row)
        residual = target - column
        squares = weight * residual**2
        far = squares / np.maximum(_excess(squares, robust, groups)[line], 1)
        inlier, robust = robust, cells.in_chain * np.clip(1 - far / _TUKEY**2, 0, None) ** 2
    width, width_sigma = _width(fit.slope, height, curvature, cells)
    on_line, fine = np.abs(residual) < 2, _with_scatter(fit, np.sqrt(weight) * residual, inlier, groups)
    # The same lines as they are seen at twice the scale.
    _, steepness, curvature = cells.sampled(field.coarse, column)
    curvature = _steady(curvature, _COARSE_CURVATURE_SIGMA, cells)
    target = column + (steepness / curvature).clip(-3, 3)
    weight = (curvature / _COARSE_STEEPNESS_SIGMA) ** 2
    coarse = groups.line(cells.row, target, weight * inlier)
    residual = target - coarse.at(line, cells.row)
    fit, shift = _of_both_scales(fine, _with_scatter(coarse, np.sqrt(weight) * residual, inlier, groups))
    # In which fraction of the line's blocks the lighter side is at the camera's maximum.
    place, last = fit.at(line, cells.row), field.grey.shape[1] - 1
    beside = np.rint(place + _BESIDE_PX * cells.polarity[line]).astype(np.int64).clip(0, last)
    clipped = cells.mean((field.grey[cells.row, beside] > _WHITE_GREY).astype(np.float64))
    # Weber's contrast: more or less light leaves it as it is, also where it falls on a part of the image only.
    step = np.sqrt(2 * np.pi) * np.maximum(cells.mean(height), 0) * width * field.noise_grey
    grey = field.grey[cells.row, np.rint(place).astype(np.int64).clip(0, last)].astype(np.float64)
    contrast = np.where(clipped < 0.5, step / np.maximum(cells.mean(grey), 1.0), np.inf)
    return Fitted(fit, height, on_line, width, width_sigma, shift, _CLIPPED_SIGMA_PX * clipped, contrast)


def _with_scatter(fit: LineFit, normalised: Array, inlier: Array, groups: Groups) -> LineFit:
    """Return lines as uncertain as their residuals (K,) say, given in units of what the noise predicts.

    The variance grows by how much more blocks scatter, and by what neighbouring residuals have in common.
    """
    excess = _excess(normalised**2, inlier, groups)
    used = np.sqrt(inlier / excess[groups.of]) * normalised
    common = float((used[1:] * used[:-1])[groups.of[1:] == groups.of[:-1]].sum())
    alike = float(np.clip(common / max(float((used**2).sum()), 1e-9), 0.0, 0.8))  # over all lines of the frame
    scatter = excess * (1 + alike) / (1 - alike)
    return fit._replace(weight=fit.weight / scatter, spread=fit.spread / scatter)


def _excess(squares: Array, inlier: Array, groups: Groups) -> Array:
    """Return by what factor (G,) the squares (K,) of normalised residuals exceed what the noise predicts, 1."""
    used = np.maximum(groups.sum(inlier) - 2, 0)
    return (_PRIOR_BLOCKS + groups.sum(inlier * squares)) / (_PRIOR_BLOCKS + used)


def _of_both_scales(fine: LineFit, coarse: LineFit) -> tuple[LineFit, Array]:
    """Return the best lines of both scales, and by how much (G,) something next to them may have moved them.

    A clean step is at the same place at every scale, and more certain at the coarser one. A shadow or a close neighbour
    shifts it in proportion to the square of the scale: by 4 instead of 1. The coarser scale is used as far as noise
    explains the difference, which has the difference of their variances. Otherwise the finer one is used, less a third
    of the difference.
    """
    sampling = _SAMPLING_SIGMA_PX[1] ** 2 - _SAMPLING_SIGMA_PX[2] ** 2
    difference = coarse.y + coarse.slope * (fine.x - coarse.x) - fine.y
    by_noise = np.maximum(1 / fine.weight - 1 / coarse.weight, 0) + sampling
    share = by_noise / np.maximum(difference**2, by_noise)
    fit = LineFit(
        x=fine.x,
        y=fine.y + difference * (share - (1 - share) / 3),
        slope=share * coarse.slope + (1 - share) * fine.slope,
        weight=1 / (share / coarse.weight + (1 - share) / fine.weight),
        spread=1 / (share / coarse.spread + (1 - share) / fine.spread),
    )
    sampling_px = share * _SAMPLING_SIGMA_PX[2] + (1 - share) * _SAMPLING_SIGMA_PX[1]
    return fit, np.hypot(np.sqrt(1 - share) * difference, sampling_px)


def _width(slope: Array, height: Array, curvature: Array, cells: Cells) -> tuple[Array, Array]:
    """Return how wide (G,) the slope of each line is, in columns, and the sigma of that by noise.

    A step D blurred by a Gaussian of scale w has a gradient of height D / (√2π w) and curvature D / (√2π w³). The
    curvature (K,) is that of neighbouring blocks together: of a line that leans, `slope` (G,), it is one of w' > w.
    """
    top, curved = np.maximum(cells.mean(height), 1e-9), np.maximum(cells.mean(curvature), 1e-9)
    leaning = _ALONG_VARIANCE * slope**2
    squared = top / curved
    width_squared = squared
    for _ in range(_WIDTH_ITERATIONS):
        width_squared = np.maximum(np.cbrt(squared**2 * width_squared) - leaning, _LEAST_WIDTH_PX**2)
    width = np.sqrt(width_squared)
    return width, width / 2 * _CURVATURE_SIGMA / (curved * np.sqrt(cells.blocks))


def samples_loop(
    values: NDArray[np.float32], row: Indices, column: Array, sign: NDArray[np.int8]
) -> tuple[Array, Array, Array]:
    """Return height, steepness and negative curvature (K,) of values (B, W) along their row, at places (K,)."""
    count, width = len(row), values.shape[1]
    height, steepness, curvature = np.empty(count), np.empty(count), np.empty(count)
    for k in range(count):
        whole = min(max(int(column[k]), 1), width - 3)
        share = min(max(column[k] - whole, 0.0), 1.0)
        s = float(sign[k])
        before, here = s * values[row[k], whole - 1], s * values[row[k], whole]
        there, after = s * values[row[k], whole + 1], s * values[row[k], whole + 2]
        height[k] = here + share * (there - here)
        steepness[k] = (there - before + share * (after - here - there + before)) / 2
        curvature[k] = 2 * here - before - there + share * (3 * (there - here) + before - after)
    return height, steepness, curvature
