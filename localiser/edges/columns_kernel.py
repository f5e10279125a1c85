"""Loops of the detector along columns, for numba to compile: rectify, find peaks, link them, fit lines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array


def corners_loop(image: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Return an image (H, W) with two rows averaged to one, halves rounded to even, as squares (H // 2 - 1, W).

    A square is four pixels in the bytes of one number, the lowest the upper left, then the upper right, the lower left
    and the lower right. So all four are looked up at once. There is none in the last column.
    """
    paired = np.empty((image.shape[0] // 2, image.shape[1]), np.uint8)
    for r in range(paired.shape[0]):
        for c in range(paired.shape[1]):
            both = np.uint16(image[2 * r, c]) + np.uint16(image[2 * r + 1, c])
            paired[r, c] = (both + ((both >> 1) & 1)) >> 1
    corners = np.zeros((paired.shape[0] - 1, paired.shape[1]), np.uint32)
    for r in range(corners.shape[0]):
        for c in range(corners.shape[1] - 1):
            upper = np.uint32(paired[r, c]) | np.uint32(paired[r, c + 1]) << np.uint32(8)
            lower = np.uint32(paired[r + 1, c]) | np.uint32(paired[r + 1, c + 1]) << np.uint32(8)
            corners[r, c] = upper | lower << np.uint32(16)
    return corners


def blocks_loop(
    corners: NDArray[np.uint32],
    corner: NDArray[np.int32],
    right: NDArray[np.uint8],
    down: NDArray[np.uint8],
    first: NDArray[np.int64],
    last: NDArray[np.int64],
    rows: int,
) -> NDArray[np.float32]:
    """Return the squares of an image looked up by a `Table`, averaged over blocks of `rows`: (B, W).

    It is 0 outside columns first … last. Bilinear in whole numbers, which float32 holds exactly. One loop only looks
    up. The other works on numbers that follow each other in memory, so compilers make it parallel; not where columns
    might be negative, for which indices would count from the end.
    """
    flat, square = corners.ravel(), np.zeros(corner.shape[1], np.uint32)
    grey = np.zeros((len(first), corner.shape[1]), np.float32)
    side, half = np.float32(32), np.float32(0.5)
    for b in range(len(first)):
        low, high = np.uint64(first[b]), np.uint64(last[b])
        for r in range(b * rows, (b + 1) * rows):
            for c in range(low, high):
                square[c] = flat[corner[r, c]]
            for c in range(low, high):
                four, x, y = square[c], np.float32(right[r, c]), np.float32(down[r, c])
                upper_left, upper_right = np.float32(np.uint8(four)), np.float32(np.uint8(four >> np.uint32(8)))
                lower_left, lower_right = np.float32(np.uint8(four >> np.uint32(16))), np.float32(four >> np.uint32(24))
                upper = upper_left * side + (upper_right - upper_left) * x
                lower = lower_left * side + (lower_right - lower_left) * x
                grey[b, c] += np.floor((upper * side + (lower - upper) * y) / (side * side) + half)
        for c in range(low, high):
            grey[b, c] /= np.float32(rows)
    return grey


def peaks_loop(
    smooth: NDArray[np.float32], unseen: NDArray[np.bool_], least: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, NDArray[np.int8]]:
    """Return row, column, sub-pixel position and sign (P,) of the peaks along rows (B, W) that are higher than `least`.

    None beside what is not seen.
    """
    rows, width = smooth.shape
    most = rows * (width // 2)
    row, column = np.empty(most, np.int64), np.empty(most, np.int64)
    position, sign = np.empty(most, np.float64), np.empty(most, np.int8)
    count = 0
    for r in range(rows):
        for c in range(1, width - 1):
            here = abs(smooth[r, c])
            if here <= least or here <= abs(smooth[r, c - 1]) or here < abs(smooth[r, c + 1]):
                continue
            if unseen[r, c - 1] or unseen[r, c] or unseen[r, c + 1]:
                continue
            polarity = 1 if smooth[r, c] > 0 else -1
            left, right = smooth[r, c - 1] * polarity, smooth[r, c + 1] * polarity
            row[count], column[count], sign[count] = r, c, polarity
            position[count] = c + (right - left) / (2 * (2 * here - left - right))
            count += 1
    return row[:count], column[:count], position[:count], sign[:count]


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
                if other < 0 or polarity[other] != polarity[p]:
                    continue
                apart = abs(position[other] - position[p])
                if apart < least:
                    least, nearest[side, p] = apart, other
    chain = np.empty(count, np.int64)
    chains = 0
    for p in range(count):
        above = nearest[0, p]
        if above >= 0 and nearest[1, above] == p:
            chain[p] = chain[above]
        else:
            chain[p] = chains
            chains += 1
    return chain


def samples_loop(
    values: NDArray[np.float32], row: NDArray[np.int64], column: Array, sign: NDArray[np.int8]
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


def line_loop(
    of: NDArray[np.int64], count: int, x: Array, y: Array, weight: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Return mean x, mean y, slope, total weight and spread of x (G,) of values (K,) in groups: `Groups.line`."""
    mean_x, mean_y, total = np.zeros(count), np.zeros(count), np.zeros(count)
    for k in range(len(of)):
        total[of[k]] += weight[k]
        mean_x[of[k]] += weight[k] * x[k]
        mean_y[of[k]] += weight[k] * y[k]
    total = np.maximum(total, 1e-12)
    mean_x, mean_y = mean_x / total, mean_y / total
    spread, slope = np.zeros(count), np.zeros(count)
    for k in range(len(of)):
        from_mean = weight[k] * (x[k] - mean_x[of[k]])
        spread[of[k]] += from_mean * (x[k] - mean_x[of[k]])
        slope[of[k]] += from_mean * y[k]
    return mean_x, mean_y, slope / np.maximum(spread, 1e-12), total, spread
