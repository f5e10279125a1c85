"""Loops over segments, for numba to compile: tilt and roll, and which segments are one edge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array


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
    and with one that is learnt. See `fit_mount`.
    """
    mean, factor = np.zeros(2), 1.0
    cov = np.array([[prior_variance[0], 0.0], [0.0, prior_variance[1]]])
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


def same_edge_loop(
    bearing: Array,
    order: NDArray[np.int64],
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

    order: (S,) from the most certain segment to the least; sorting would take longer to compile than all of this.
    told_apart: (S, 2) least difference that can be told apart, and by scatter. extent: (S, 2) lowest and highest e.
    """
    count = len(bearing)
    edge = np.full(count, -1, np.int64)
    edges = 0
    for first in order:
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
