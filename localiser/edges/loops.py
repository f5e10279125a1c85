"""The inner loops of the detector, for numba to compile: where numpy's cost is that of its calls, not of the work."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array


def pairs_loop(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image (H, W) with two rows averaged to one (H // 2, W); halves are rounded to even."""
    paired = np.empty((image.shape[0] // 2, image.shape[1]), np.uint8)
    for r in range(paired.shape[0]):
        for c in range(paired.shape[1]):
            both = np.uint16(image[2 * r, c]) + np.uint16(image[2 * r + 1, c])
            paired[r, c] = (both + ((both >> 1) & 1)) >> 1
    return paired


def blocks_loop(
    image: NDArray[np.uint8],
    corner: NDArray[np.int32],
    right: NDArray[np.uint8],
    down: NDArray[np.uint8],
    first: NDArray[np.int64],
    last: NDArray[np.int64],
    rows: int,
) -> NDArray[np.float32]:
    """Return an image looked up by a `Table`, averaged over blocks of `rows`: (B, W), 0 outside columns first … last.

    Bilinear in whole numbers; a loop over one row of one table at a time is what compilers make parallel.
    """
    flat, width = image.ravel(), image.shape[1]
    grey = np.zeros((len(first), corner.shape[1]), np.float32)
    for b in range(len(first)):
        for r in range(b * rows, (b + 1) * rows):
            for c in range(first[b], last[b]):
                at, x, y = corner[r, c], np.int32(right[r, c]), np.int32(down[r, c])
                upper_left, lower_left = np.int32(flat[at]), np.int32(flat[at + width])
                upper = (upper_left << 5) + (np.int32(flat[at + 1]) - upper_left) * x
                lower = (lower_left << 5) + (np.int32(flat[at + width + 1]) - lower_left) * x
                grey[b, c] += np.float32(((upper << 5) + (lower - upper) * y + 512) >> 10)
        for c in range(first[b], last[b]):
            grey[b, c] /= np.float32(rows)
    return grey


def median_size_loop(values: NDArray[np.float32], index: NDArray[np.int64]) -> float:
    """Return the median size of the values at flat indices."""
    flat, size = values.ravel(), np.empty(len(index), np.float32)
    for k in range(len(index)):
        size[k] = abs(flat[index[k]])
    return float(np.median(size))


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


def sides_loop(
    image: NDArray[np.uint8], nodes: Array, before: NDArray[np.int64], share: Array, sides_px: Array, outwards: int
) -> Array:
    """Return mean grey values (E, S, 2) left and right of polylines (E, N, 2), nan from where they leave the image.

    before, share: (S,) which node each place lies behind, and how far on the way to the next. sides_px: (K,) offsets
    along u, the first half of them to the left. outwards: the first place that may follow on from one outside.
    """
    lines, places, half = len(nodes), len(before), len(sides_px) // 2
    last_u, last_v, reach = image.shape[1] - 1, image.shape[0] - 1, np.abs(sides_px).max()
    grey = np.full((lines, places, 2), np.nan)
    for line in range(lines):
        for place in range(places):
            n, part = before[place], share[place]
            u = nodes[line, n, 0] * (1 - part) + nodes[line, n + 1, 0] * part
            v = nodes[line, n, 1] * (1 - part) + nodes[line, n + 1, 1] * part
            if not (reach <= u <= last_u - reach and 0 <= v <= last_v):
                if place >= outwards:  # a lens model may bend what is far outside back into the image
                    break
                continue
            top = min(int(v), last_v - 1)
            down = v - top
            for side in range(2):
                total = 0.0
                for k in range(half):
                    at = u + sides_px[side * half + k]
                    left = min(int(at), last_u - 1)
                    right = at - left
                    upper = image[top, left] * (1 - right) + image[top, left + 1] * right
                    lower = image[top + 1, left] * (1 - right) + image[top + 1, left + 1] * right
                    total += upper * (1 - down) + lower * down
                grey[line, place, side] = total / half
    return grey


def changes_loop(grey: Array, first: int, last: int) -> Array:
    """Return by how much grey values (E, S, 2) change at most between two places and the next two: (E, 2).

    From place `first` on up to, not including, `last`; 0 where nothing is seen.
    """
    changes = np.zeros((len(grey), 2))
    for line in range(len(grey)):
        for side in range(2):
            for k in range(first, last - 3):
                before = grey[line, k, side] + grey[line, k + 1, side]
                change = abs(before - grey[line, k + 2, side] - grey[line, k + 3, side]) / 2
                if change > changes[line, side]:  # noqa: PLR1730  (never for nan)
                    changes[line, side] = change
    return changes


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


def mount_loop(
    angle: Array,
    per_mount: Array,
    variance: Array,
    crooked_variance: Array,
    prior_variance: Array,
    tukey: tuple[float, float],
    prior_edges: float,
    iterations: tuple[int, int],
) -> tuple[Array, Array, float]:
    """Return mean (2,) and covariance (2, 2) of tilt and roll that angles (S,) tell, and a factor on crooked_variance.

    tukey: where weights end, and the share of a Gaussian's variance that they leave. iterations: with a factor of 1,
    and with one that is learnt. See `mount_error`, `mount_error_of_pointing`.
    """
    mean, cov, factor = np.zeros(2), np.diag(prior_variance), 1.0
    for iteration in range(iterations[0] + iterations[1]):
        says = crooked = 0.0
        # Information matrix ((a, b), (b, d)) and vector (p, q).
        a, b, d, p, q = 1 / prior_variance[0], 0.0, 1 / prior_variance[1], 0.0, 0.0
        for k in range(len(angle)):
            t, r = per_mount[k, 0], per_mount[k, 1]
            remaining = cov[0, 0] * t * t + 2 * cov[0, 1] * t * r + cov[1, 1] * r * r
            miss = angle[k] + t * mean[0] + r * mean[1]
            own = factor * crooked_variance[k]
            total = own + variance[k]
            trust = max(1 - miss**2 / (tukey[0] ** 2 * (total + remaining)), 0.0) ** 2
            weight = trust / total
            says += trust
            if own > 0:
                part = own / total
                crooked += trust * (part**2 * (miss**2 + remaining) + part * variance[k]) / crooked_variance[k]
            a, b, d = a + weight * t * t, b + weight * t * r, d + weight * r * r
            p, q = p - weight * t * angle[k], q - weight * r * angle[k]
        cov = np.array([[d, -b], [-b, a]]) / (a * d - b * b)
        mean = np.array([cov[0, 0] * p + cov[0, 1] * q, cov[1, 0] * p + cov[1, 1] * q])
        if iteration >= iterations[0] - 1 and iteration < iterations[0] + iterations[1] - 1:
            factor = (prior_edges + crooked / tukey[1]) / (prior_edges + says)
    return mean, cov, factor


def vertical_loop(
    miss: Array, variance: Array, crooked_variance: Array, reach: float, prior: float, iterations: int
) -> Array:
    """Return how likely lines (S,) are vertical: `vertical_probability`."""
    count = len(miss)
    probability = np.empty(count)
    share, factor = 0.5, 1.0
    for _ in range(iterations):
        vertical, crooked = prior / 2, prior
        says = prior
        for k in range(count):
            own = factor * crooked_variance[k]
            wide = math.sqrt(2 * (variance[k] + own))
            upright = math.exp(-((miss[k] / wide) ** 2)) / (wide * math.sqrt(math.pi))
            other = (math.erf((miss[k] + reach) / wide) - math.erf((miss[k] - reach) / wide)) / (4 * reach)
            upright, other = share * upright, max((1 - share) * other, 1e-300)
            probability[k] = upright / (upright + other)
            part = own / (variance[k] + own)
            expected = part**2 * miss[k] ** 2 + part * variance[k]
            vertical += probability[k]
            says += probability[k]
            crooked += probability[k] * expected / crooked_variance[k]
        share, factor = vertical / (count + prior), crooked / says
    return probability


def same_edge_loop(
    bearing: Array,
    per_mount: Array,
    mount_cov: Array,
    variance: Array,
    told_apart: Array,
    extent: Array,
    polarity: NDArray[np.int8],
    gate_sigma: float,
    beside_share: float,
) -> NDArray[np.int64]:
    """Return the edge (S,) of each segment, the most certain one gathering first: `same_edge`.

    told_apart: (S, 2) least difference that can be told apart, and by scatter. extent: (S, 2) lowest and highest e.
    """
    count = len(bearing)
    edge = np.full(count, -1, np.int64)
    edges = 0
    for first in np.argsort(variance, kind="mergesort"):
        if edge[first] >= 0:
            continue
        for other in range(count):
            if edge[other] >= 0 or polarity[other] != polarity[first]:
                continue
            by_tilt, by_roll = per_mount[other] - per_mount[first]
            by_mount = mount_cov[0, 0] * by_tilt**2 + 2 * mount_cov[0, 1] * by_tilt * by_roll
            by_mount += mount_cov[1, 1] * by_roll**2
            allowed = gate_sigma * np.sqrt(variance[first] + variance[other] + by_mount)
            common = min(extent[first, 1], extent[other, 1]) - max(extent[first, 0], extent[other, 0])
            shorter = min(extent[first, 1] - extent[first, 0], extent[other, 1] - extent[other, 0])
            if common > beside_share * shorter:
                scatter = np.hypot(told_apart[first, 1], told_apart[other, 1])
                allowed = min(allowed, max(told_apart[other, 0], scatter))
            if abs(bearing[other] - bearing[first]) <= allowed:
                edge[other] = edges
        edges += 1
    return edge
