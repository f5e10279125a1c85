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
    settled: float,
) -> tuple[Array, Array, float]:
    """Return tilt, roll and lens (3,) with covariance (3, 3) that angles (S,) tell, and a factor on crooked_variance.

    per_mount: (S, 3). prior_variance: (3,). tukey: where weights end, and the share of a Gaussian's variance that they
    leave. iterations: with a factor of 1, and with one that is learnt, until it changes by less than the fraction
    `settled`. See `fit_mount`.
    """
    state, cov, factor = np.zeros(3), np.diag(prior_variance), 1.0
    for iteration in range(iterations[0] + iterations[1]):
        says = crooked = 0.0
        information, pull = np.diag(1 / prior_variance), np.zeros(3)
        for k in range(len(angle)):
            by = per_mount[k]
            miss, remaining = angle[k], 0.0
            for i in range(3):
                miss += by[i] * state[i]
                for j in range(3):
                    remaining += cov[i, j] * by[i] * by[j]
            own = factor * crooked_variance[k]
            total = own + variance[k]
            trust = max(1 - miss**2 / (tukey[0] ** 2 * (total + remaining)), 0.0) ** 2
            weight = trust / total
            says += trust
            if own > 0:
                part = own / total
                crooked += trust * (part**2 * (miss**2 + remaining) + part * variance[k]) / crooked_variance[k]
            for i in range(3):
                pull[i] -= weight * by[i] * angle[k]
                for j in range(3):
                    information[i, j] += weight * by[i] * by[j]
        # The inverse of a symmetric 3 × 3 matrix by its cofactors.
        for i in range(3):
            for j in range(3):
                a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
                cov[i, j] = information[a, c] * information[b, d] - information[a, d] * information[b, c]
        cov /= information[0, 0] * cov[0, 0] + information[0, 1] * cov[0, 1] + information[0, 2] * cov[0, 2]
        for i in range(3):
            state[i] = cov[i, 0] * pull[0] + cov[i, 1] * pull[1] + cov[i, 2] * pull[2]
        if iteration >= iterations[0] - 1 and iteration < iterations[0] + iterations[1] - 1:
            before, factor = factor, (prior_edges + crooked / tukey[1]) / (prior_edges + says)
            if abs(factor - before) < settled * before:
                break
    return state, cov, factor


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
