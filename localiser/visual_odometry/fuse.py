"""Fuse several Gaussian motions into one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from localiser.geometry import Array, wrap_angle
from localiser.visual_odometry.twist import Gaussian


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


def at_least(cov: Array, other: Array) -> Array:
    """Return the smallest covariance (3, 3) that is in no direction below either: both estimate the same spread."""
    root = np.linalg.cholesky(cov)
    inverse = np.linalg.inv(root)
    ratio, axes = np.linalg.eigh(inverse @ other @ inverse.T)
    grown = root @ axes * np.sqrt(np.maximum(ratio, 1.0))
    return np.asarray(grown @ grown.T)
