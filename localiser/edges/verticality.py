"""The probability that an edge is vertical: its free slope compared with the slope that its position predicts."""

from __future__ import annotations

import numpy as np

from localiser.camera import Camera
from localiser.edges.mount import fit_mount, nadir_miss, nadir_miss_of_edges
from localiser.edges.segments import Segments
from localiser.edges.types import Edges
from localiser.edges.vertical import REACH_RAD
from localiser.geometry import Array

_PRIOR_LINES = 2.0
"""As how many lines it counts that half of all lines are vertical, and that these are as crooked as is stated."""
_LEAST_RAD = 1e-6
_ITERATIONS = 20


def vertical_probability(
    edges: Edges, rejected: Segments, camera: Camera, mount_sigma_rad: Array, plumb_sigma_rad: float
) -> Array:
    """Return how likely edges (E) are vertical ones, (E,), and not lines that happen to point at the nadir point.

    p(miss) = v N(0, sigma²) + (1 - v) (uniform within ±`REACH_RAD`, measured with sigma). miss is the free slope less
    the one that the position predicts ([Taylor06] eq. 7), under the mount that the image's edges tell; sigma is of the
    slope, of edges that are crooked, and of that mount. v, the share of lines that are vertical, and how crooked these
    are, are learnt from the image's edges and from the segments (R) that were `rejected`, by expectation maximisation.
    Edges with a slope too uncertain to say anything have v.
    """
    if len(edges) == 0:
        return np.zeros(0)
    pointing = nadir_miss_of_edges(edges, camera, plumb_sigma_rad)
    mount = fit_mount(pointing, mount_sigma_rad, learn_crooked=True)
    others = nadir_miss(rejected, camera, plumb_sigma_rad)
    others = others.take(np.abs(others.corrected(mount)[0]) < REACH_RAD)
    misses, by_mount = zip(pointing.corrected(mount), others.corrected(mount), strict=True)
    variance = np.concatenate([pointing.sigma, others.sigma]) ** 2 + np.concatenate(by_mount)
    crooked_variance = np.concatenate([pointing.crooked, others.crooked]) ** 2 + _LEAST_RAD**2
    return _responsibility(np.concatenate(misses), variance, crooked_variance)[: len(edges)]


def _responsibility(miss: Array, variance: Array, crooked_variance: Array) -> Array:
    """Return how likely lines (S,) that miss by so much are vertical, by expectation maximisation."""
    from scipy.special import erf

    vertical, factor = 0.5, 1.0
    for _ in range(_ITERATIONS):
        own = factor * crooked_variance
        wide = np.sqrt(2 * (variance + own))
        upright = vertical * np.exp(-((miss / wide) ** 2)) / (wide * np.sqrt(np.pi))
        other = (erf((miss + REACH_RAD) / wide) - erf((miss - REACH_RAD) / wide)) / (4 * REACH_RAD)
        probability = upright / (upright + np.maximum((1 - vertical) * other, 1e-300))
        part = own / (variance + own)
        expected = part**2 * miss**2 + part * variance
        vertical = (_PRIOR_LINES / 2 + probability.sum()) / (len(miss) + _PRIOR_LINES)
        crooked = _PRIOR_LINES + (probability * expected / crooked_variance).sum()
        factor = crooked / (_PRIOR_LINES + probability.sum())
    return np.asarray(probability)
