"""The loop of `guide`, compiled by numba when this module is imported and its function is first called."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

from localiser.geometry import Array

F = TypeVar("F", bound=Callable[..., Any])

NEAREST_M = 0.05  # ahead of the camera; what is nearer or behind tells nothing


def _entry(function: F) -> F:
    return cast(F, njit(cache=True, nogil=True, error_model="numpy")(function))


@_entry
def told(
    poses: Array,
    axes: Array,
    targets: Array,
    offset: tuple[float, float, float],
    sin_tilt: float,
    is_slope: bool,
) -> tuple[Array, Array, Array]:
    """Return the root L (6, N) of A = I + Σ g gᵀ/σ², L⁻¹ Σ g r/σ² (3, N) and log evidence ψ (N,).

    poses: (3, N) x, z, heading of the camera's yaw included. axes: (3, 3, N) their derivatives by the standardised
    step. targets: (K, 4) x, z, angle, 1/σ². offset: of the camera on the robot, right, back, yaw. g = ∂angle/∂step and
    r, the measured angle less the expected one, are those of a target. L's rows: 00, 10, 11, 20, 21, 22.
    """
    right_m, back_m, yaw = offset
    count = poses.shape[1]
    root, explained, log_evidence = np.empty((6, count)), np.empty((3, count)), np.empty(count)
    for n in range(count):
        cos, sin = np.cos(poses[2, n]), np.sin(poses[2, n])
        offset_x, offset_z = cos * right_m + sin * back_m, cos * back_m - sin * right_m
        cos, sin = np.cos(poses[2, n] + yaw), np.sin(poses[2, n] + yaw)
        a00 = a11 = a22 = 1.0
        a10 = a20 = a21 = b0 = b1 = b2 = misfit = 0.0
        for k in range(len(targets)):
            dx, dz = targets[k, 0] - poses[0, n] - offset_x, targets[k, 1] - poses[1, n] - offset_z
            right, ahead = dx * cos - dz * sin, -(dx * sin + dz * cos)
            if ahead < NEAREST_M:
                continue
            square = right * right + ahead * ahead
            per_x, per_z = -(ahead * cos + right * sin) / square, (ahead * sin - right * cos) / square
            per_heading = 1.0 + per_x * offset_z - per_z * offset_x
            across = sin_tilt * right if is_slope else right
            per_bearing = sin_tilt * square / (ahead * ahead + across * across) if is_slope else 1.0
            residual = targets[k, 2] - np.arctan2(across, ahead)
            g0 = per_bearing * (per_x * axes[0, 0, n] + per_z * axes[1, 0, n] + per_heading * axes[2, 0, n])
            g1 = per_bearing * (per_x * axes[0, 1, n] + per_z * axes[1, 1, n] + per_heading * axes[2, 1, n])
            g2 = per_bearing * (per_x * axes[0, 2, n] + per_z * axes[1, 2, n] + per_heading * axes[2, 2, n])
            weight = targets[k, 3]
            a00, a11, a22 = a00 + weight * g0 * g0, a11 + weight * g1 * g1, a22 + weight * g2 * g2
            a10, a20, a21 = a10 + weight * g1 * g0, a20 + weight * g2 * g0, a21 + weight * g2 * g1
            pull = weight * residual
            b0, b1, b2, misfit = b0 + pull * g0, b1 + pull * g1, b2 + pull * g2, misfit + pull * residual
        l00 = np.sqrt(a00)
        l10, l20 = a10 / l00, a20 / l00
        l11 = np.sqrt(a11 - l10 * l10)
        l21 = (a21 - l20 * l10) / l11
        l22 = np.sqrt(a22 - l20 * l20 - l21 * l21)
        root[0, n], root[1, n], root[2, n] = l00, l10, l11
        root[3, n], root[4, n], root[5, n] = l20, l21, l22
        y0 = b0 / l00
        y1 = (b1 - l10 * y0) / l11
        y2 = (b2 - l20 * y0 - l21 * y1) / l22
        explained[0, n], explained[1, n], explained[2, n] = y0, y1, y2
        log_evidence[n] = 0.5 * (y0 * y0 + y1 * y1 + y2 * y2 - misfit) - np.log(l00 * l11 * l22)
    return root, explained, log_evidence
