"""Tilt and roll from lines: the vertical direction that most of them agree on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.calibration.lines import Lines, down_in_camera
from localiser.geometry import Array

PRIOR_SIGMA_RAD = np.deg2rad([5.0, 3.0])
"""How far stated tilt and roll are off at most, one sigma: so wide that it decides only what no edge tells."""
REACH_SIGMA = 2.5
"""Down is looked for as many of these sigmas around what is stated."""
_GRID_RAD = np.deg2rad(0.5)
_WIDEST_MISS_RAD = np.deg2rad(10.0)
"""Lines that are no vertical edges miss down by anything up to this, each value as likely."""
_LEAST_PLUMB_RAD = np.deg2rad(0.02)
"""Nothing is built, and no lens calibrated, better than this."""
_ITERATIONS = 100
_CONVERGED_RAD = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Plumb:
    """What lines (K) say about tilt and roll.

    mount: (2,) rad, cov: (2, 2) as if lines erred independently. plumb_sigma: rad, how far vertical edges are from
    plumb beyond the error of measuring them. vertical: (K,) probability that a line is a vertical edge.
    """

    mount: Array
    cov: Array
    plumb_sigma: float
    vertical: Array


def voted(lines: Lines, stated: Array) -> Array:
    """Return the tilt and roll (2,) around the stated, on a grid of half a degree, that most lines (K) agree with."""
    reach = np.floor(REACH_SIGMA * PRIOR_SIGMA_RAD / _GRID_RAD)
    tilt, roll = (stated[i] + _GRID_RAD * np.arange(-reach[i], reach[i] + 1) for i in range(2))
    candidates = np.stack(np.meshgrid(tilt, roll, indexing="ij"), axis=-1).reshape(-1, 2)
    down = down_in_camera(candidates).T
    votes = np.zeros(len(candidates))
    for part in np.array_split(np.arange(len(lines)), len(lines) // 500 + 1):
        some = lines.take(part)
        sigma = np.hypot(some.sigma[:, None] * (some.per_turn @ down), _GRID_RAD)
        # An uncertain line agrees with much, so its voice counts less in each place.
        votes += (np.exp(-((some.normal @ down / sigma) ** 2) / 2) / sigma).sum(axis=0)
    return np.asarray(candidates[np.argmax(votes)])


def fitted(lines: Lines, stated: Array, start: Array, plumb_sigma: float | None = None) -> Plumb:
    """Return what lines (K) say about tilt and roll, from a `start` (2,) near it, with the prior N(stated, PRIOR²).

    p(miss) = v N(0, sigma² + plumb_sigma²) + (1 - v) uniform, by expectation maximisation over which lines are
    vertical; v and, when not given, plumb_sigma are found as well. With known weights this is design equation 10: the
    direction whose squared misses sum to the least.
    """
    prior = np.diag(PRIOR_SIGMA_RAD**-2)
    mount, share = start, 0.5
    plumb = plumb_sigma or _GRID_RAD / 2
    for _ in range(_ITERATIONS):
        miss, per_mount, sigma = lines.misses(mount)
        variance = sigma**2 + plumb**2
        density = np.exp(-(miss**2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)
        vertical = share * density / (share * density + (1 - share) / (2 * _WIDEST_MISS_RAD))
        weight = vertical / variance
        cov = np.asarray(np.linalg.inv(prior + per_mount.T @ (weight[:, None] * per_mount)))
        step = cov @ (prior @ (stated - mount) - per_mount.T @ (weight * miss))
        mount = mount + step
        if len(lines):
            share = float(np.clip(vertical.mean(), 0.01, 0.99))
        if len(lines) and plumb_sigma is None:
            precise = vertical / variance**2
            excess = float((precise * (miss**2 - sigma**2)).sum() / max(float(precise.sum()), 1e-300))
            plumb = float(np.sqrt(max(excess, _LEAST_PLUMB_RAD**2)))
        if np.abs(step).max() < _CONVERGED_RAD:
            break
    return Plumb(mount, cov, plumb, vertical)
