"""Wheels and edges together, when wheels may slip without knowing it.

There are two readings of the same edges: the wheels are right to within their sigma, and the edges are followed from
there; or the wheels slipped, and the edges are followed from nothing. Each explains the edges more or less well, and
Bayes' rule weighs them by that. Wheels that agree with the edges make the first reading certain; a slip makes pairs
under it impossible, and the second takes over, of itself. Between the two the result is a mixture, and its covariance
reaches from the one to the other [Bar-Shalom, Li, Kirubarajan 2001, section 1.4.16]: contradictions are never averaged
into something certain, and the map decides.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from localiser.geometry import Array, wrap_angle
from localiser.increments.solve import Gaussian


def mixture(parts: Sequence[Gaussian], log_weight: Array) -> Gaussian:
    """Return the Gaussian with mean and covariance of a mixture of K motions; log_weight: (K,), up to a constant."""
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    origin = parts[int(weight.argmax())].mean
    offset = np.array([part.mean - origin for part in parts])
    offset[:, 2] = wrap_angle(offset[:, 2])
    mean = weight @ offset
    spread = offset - mean
    cov = np.einsum("k,kij->ij", weight, [part.cov for part in parts]) + np.einsum(
        "k,ki,kj->ij", weight, spread, spread
    )
    total = origin + mean
    total[2] = wrap_angle(total[2])
    return Gaussian(total, cov)
