"""The loop of `evidence`, compiled by numba when this module is imported and its function is first called."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.geometry.compiled import compiled

Indices = NDArray[np.int64]


@compiled
def score(
    poses: Array,
    landmarks: Array,
    sight: Array,
    floor: Array,
    shape: tuple[int, int, int],
    start: Indices,
    item: NDArray[np.int32],
    edge: NDArray[np.int16],
    fit: NDArray[np.float32],
    edges: int,
    grid: Array,
) -> Array:
    """Return the score (N,) of camera poses (N, 3), one pose and one landmark in view after the other.

    landmarks: (L, 4) x, z, and the heights of both ends above the camera. sight: sine and cosine of the tilt, nearest
    and farthest range. floor, shape, start, item: the landmarks' index, floor being corner and cell. grid: low and step
    of tan(bearing), low and step of e.
    """
    result = np.zeros(len(poses))
    s, c = sight[0], sight[1]
    rows, columns = fit.shape
    explained = np.zeros(edges)
    low, high, per_column = grid[0], grid[0] + (columns - 0.01) * grid[1], 1.0 / grid[1]
    per_row = 1.0 / grid[3]
    nearest, farthest = sight[2] ** 2, sight[3] ** 2
    for n in range(len(poses)):
        x, z, heading = poses[n, 0], poses[n, 1], poses[n, 2]
        i, j = int(np.floor((x - floor[0]) / floor[2])), int(np.floor((z - floor[1]) / floor[2]))
        if i < 0 or j < 0 or i >= shape[0] or j >= shape[1]:  # where nothing is in view, nothing is explained
            result[n] = edges * np.log(0.5)
            continue
        sector = int(np.floor((heading + np.pi) * shape[2] / (2 * np.pi))) % shape[2]
        cell = (i * shape[1] + j) * shape[2] + sector
        cos, sin = np.cos(heading), np.sin(heading)
        explained[:] = 0.0
        in_view = 0
        for place in range(start[cell], start[cell + 1]):
            k = item[place]
            dx, dz = landmarks[k, 0] - x, landmarks[k, 1] - z
            ahead = -(dx * sin + dz * cos)
            right = dx * cos - dz * sin
            # Outside the field of view: told without a division.
            if ahead <= 1e-6 or right <= low * ahead or right >= high * ahead:
                continue
            squared = right * right + ahead * ahead
            if squared < nearest or squared > farthest:
                continue
            # The top must be above the image's lower border, the foot below its upper one.
            top, bottom = landmarks[k, 3], landmarks[k, 2]
            if top * c + ahead * s < grid[2] * max(ahead * c - top * s, 1e-6):
                continue
            depth = max(ahead * c - bottom * s, 1e-6)
            inverse = 1.0 / (ahead * depth)  # one division for both quotients
            row = max(int(np.floor(((bottom * c + ahead * s) * ahead * inverse - grid[2]) * per_row)) + 1, 0)
            if row >= rows - 1:
                continue
            in_view += 1
            column = int((right * depth * inverse - low) * per_column)
            best = edge[row, column]
            if best >= 0:
                explained[best] += fit[row, column]
        clutter, each = 0.5, 0.5 / max(in_view, 1)
        product, total = 1.0, 0.0  # one logarithm for many factors, as long as their product is a number
        for k in range(edges):
            product *= clutter + each * explained[k]
            if product > 1e100 or product < 1e-100:
                total += np.log(product)
                product = 1.0
        result[n] = total + np.log(product)
    return result
