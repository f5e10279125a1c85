"""Consistency of residuals: do edges lie as far from their landmarks as their sigmas say? It needs no truth.

A residual is a measured angle minus the angle at which the estimate expects the matched landmark; z is the residual
divided by its sigma. An edge is matched up to a gate of g sigmas and counts as clutter beyond. So z has a normal
distribution that is cut off at ±g, with

    E[z²] = 1 - 2 g φ(g) / P,    E[z⁴] = 3 - 2 (g³ + 3 g) φ(g) / P,    P = Φ(g) - Φ(-g).

The consistency of an image is Σ z² / Σ E[z²] over its matched edges. It is 1 where sigmas are right, larger where they
are too small, and smaller where they are too large. It is a little smaller anyway, because the estimate was fitted to
these edges.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from localiser.geometry import Array
from localiser.observation import Matches

_LARGEST_GATE, _SMALLEST_GATE = 40.0, 1e-2  # beyond the one nothing is cut off; below the other rounding prevails


def residual_sums(matches: Matches) -> Array:
    """Return Σ z², its expectation and its variance (3,) over the matched edges of one image.

    nan where sigmas are not known, or nothing is matched.
    """
    residual, sigma, gate = matches.residual, matches.sigma, matches.gate
    if sigma is None or gate is None:
        return np.full(3, np.nan)
    known = np.isfinite(residual) & (sigma > 0) & (gate > 0)
    if not known.any():
        return np.full(3, np.nan)
    mean, variance = _moments(gate[known])
    return np.array([np.square(residual[known] / sigma[known]).sum(), mean.sum(), variance.sum()])


def consistency(sums: Array) -> Array:
    """Return Σ z² / Σ E[z²] (T,) of images, from `residual_sums` (T, 3)."""
    return np.asarray(sums[:, 0] / sums[:, 1])


def consistency_band(sums: Array, probability: float = 0.95) -> tuple[Array, Array]:
    """Return the band (T,), (T,) that the consistency of an image lies in with this probability, errors independent.

    The sum is taken as a gamma variable of its mean and variance, which it is exactly, a χ², where nothing is cut off.
    """
    from scipy.special import gammaincinv

    shape = sums[:, 1] ** 2 / sums[:, 2]
    low, high = (gammaincinv(shape, tail) / shape for tail in ((1 - probability) / 2, (1 + probability) / 2))
    return np.asarray(low), np.asarray(high)


def residual_figures(sums: Array) -> dict[str, Any]:
    """Return the consistency over all images of `residual_sums` (T, 3), and the fraction of images inside the band."""
    known = sums[np.isfinite(sums).all(axis=1)]
    if not len(known):
        return {"consistency": None, "images_inside_95": None}
    each, (low, high) = consistency(known), consistency_band(known)
    return {
        "consistency": round(float(known[:, 0].sum() / known[:, 1].sum()), 6),
        "images_inside_95": round(float(((each >= low) & (each <= high)).mean()), 6),
    }


def _moments(gate: Array) -> tuple[Array, Array]:
    """Return mean and variance (E,) of z², z standard normal and cut off at ±gate (E,)."""
    from scipy.special import erf

    g = np.clip(gate, _SMALLEST_GATE, _LARGEST_GATE)
    ratio = 2 * np.exp(-0.5 * g**2) / np.sqrt(2 * np.pi) / erf(g / np.sqrt(2))
    mean = 1 - g * ratio
    return np.asarray(mean), np.asarray(np.maximum(3 - (g**3 + 3 * g) * ratio - mean**2, 0.0))
