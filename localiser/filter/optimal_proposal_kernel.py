"""The loop of `optimal_proposal`, compiled by numba when this module is imported and its function is first called.

Blocks of particles look at one target at a time, along rows of one array of constant shape: only so does the compiler
know that rows do not overlap, and turns the loop into vector instructions.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from localiser.geometry import Array
from localiser.geometry.angle_kernel import arctan
from localiser.geometry.compiled import entry, inlined

LEAST_AHEAD_M = 0.05  # ahead of the camera; what is nearer or behind tells nothing
BLOCK = 64  # particles looked at together

# Rows of a block: camera, axes of the step, the camera's offset from the robot, and what targets add up to.
_X, _Z, _COS, _SIN = range(4)
_AXES, _GIVEN = 4, 13  # 9 rows
_OFFSET_X, _OFFSET_Z, _A00, _A10, _A11, _A20, _A21, _A22, _B0, _B1, _B2, _LOG = range(13, 25)


@inlined
def _place(block: Array, offset: Any) -> None:
    """Move from robots to their cameras, of which nothing is told yet."""
    right_m, back_m, cos_yaw, sin_yaw = offset
    for m in range(BLOCK):
        cos, sin = block[_COS, m], block[_SIN, m]
        offset_x, offset_z = cos * right_m + sin * back_m, cos * back_m - sin * right_m
        block[_OFFSET_X, m], block[_OFFSET_Z, m] = offset_x, offset_z
        block[_X, m] += offset_x
        block[_Z, m] += offset_z
        block[_COS, m], block[_SIN, m] = cos * cos_yaw - sin * sin_yaw, sin * cos_yaw + cos * sin_yaw
        block[_A00, m], block[_A11, m], block[_A22, m] = 1.0, 1.0, 1.0
        block[_A10, m], block[_A20, m], block[_A21, m] = 0.0, 0.0, 0.0
        block[_B0, m], block[_B1, m], block[_B2, m], block[_LOG, m] = 0.0, 0.0, 0.0, 0.0


@inlined
def _add(block: Array, target: Any, sin_tilt: float, is_slope: bool) -> None:
    """Add what a target tells of each step."""
    x, z, cos_angle, sin_angle, certain = target
    for m in range(BLOCK):
        cos, sin = block[_COS, m], block[_SIN, m]
        dx, dz = x - block[_X, m], z - block[_Z, m]
        right, ahead = dx * cos - dz * sin, -(dx * sin + dz * cos)
        weight = certain if ahead >= LEAST_AHEAD_M else 0.0
        ahead = ahead if ahead >= LEAST_AHEAD_M else LEAST_AHEAD_M
        square = right * right + ahead * ahead
        per_x, per_z = -(ahead * cos + right * sin) / square, (ahead * sin - right * cos) / square
        per_heading = 1.0 + per_x * block[_OFFSET_Z, m] - per_z * block[_OFFSET_X, m]
        across = sin_tilt * right if is_slope else right
        per_bearing = sin_tilt * square / (ahead * ahead + across * across) if is_slope else 1.0

        # Measured less expected angle, by the arctangent of smaller over larger.
        one, other = sin_angle * ahead - cos_angle * across, cos_angle * ahead + sin_angle * across
        steep = abs(one) > abs(other)
        residual = arctan((abs(other) if steep else abs(one)) / (abs(one) if steep else abs(other)))
        residual = np.pi / 2 - residual if steep else residual
        residual = np.pi - residual if other < 0 else residual
        residual = -residual if one < 0 else residual

        g0 = per_x * block[_AXES, m] + per_z * block[_AXES + 3, m] + per_heading * block[_AXES + 6, m]
        g1 = per_x * block[_AXES + 1, m] + per_z * block[_AXES + 4, m] + per_heading * block[_AXES + 7, m]
        g2 = per_x * block[_AXES + 2, m] + per_z * block[_AXES + 5, m] + per_heading * block[_AXES + 8, m]
        block[_LOG, m] -= 0.5 * weight * residual * residual
        weight *= per_bearing
        pull = weight * residual
        weight *= per_bearing
        block[_A00, m] += weight * g0 * g0
        block[_A11, m] += weight * g1 * g1
        block[_A22, m] += weight * g2 * g2
        block[_A10, m] += weight * g1 * g0
        block[_A20, m] += weight * g2 * g0
        block[_A21, m] += weight * g2 * g1
        block[_B0, m] += pull * g0
        block[_B1, m] += pull * g1
        block[_B2, m] += pull * g2


@inlined
def _factor(block: Array) -> None:
    """Put the root L, L⁻¹ b and the evidence but for -log(l00 l11 l22) in the place of A, b and misfit."""
    for m in range(BLOCK):
        l00 = np.sqrt(block[_A00, m])
        l10, l20 = block[_A10, m] / l00, block[_A20, m] / l00
        l11 = np.sqrt(block[_A11, m] - l10 * l10)
        l21 = (block[_A21, m] - l20 * l10) / l11
        l22 = np.sqrt(block[_A22, m] - l20 * l20 - l21 * l21)
        block[_A00, m], block[_A10, m], block[_A11, m] = l00, l10, l11
        block[_A20, m], block[_A21, m], block[_A22, m] = l20, l21, l22
        y0 = block[_B0, m] / l00
        y1 = (block[_B1, m] - l10 * y0) / l11
        y2 = (block[_B2, m] - l20 * y0 - l21 * y1) / l22
        block[_B0, m], block[_B1, m], block[_B2, m] = y0, y1, y2
        block[_LOG, m] += 0.5 * (y0 * y0 + y1 * y1 + y2 * y2)


@entry
def linearised(
    steps: Array, targets: Array, offset: tuple[float, float, float, float], sin_tilt: float, is_slope: bool
) -> Array:
    """Return (10, N) of particles: the root L of A = I + Σ g gᵀ/σ², y = L⁻¹ Σ g r/σ², and (|y|² - Σ r²/σ²) / 2.

    steps: (13, N) x, z, cosine and sine of the heading, the camera's yaw included, and derivatives (3, 3) of x, z,
    heading by the standardised step. targets: (K, 5) x, z, cosine and sine of the angle, 1/σ². offset: of the camera on
    the robot, right, back, cosine and sine of the yaw. g = ∂angle/∂step and r, the measured angle less the expected
    one, are those of a target. L's rows: 00, 10, 11, 20, 21, 22.
    """
    count = steps.shape[1]
    result, block = np.empty((10, count)), np.zeros((25, BLOCK))
    for first in range(0, count, BLOCK):
        size = min(BLOCK, count - first)
        for row in range(_GIVEN):  # copied one by one: an assignment of slices takes two seconds more to compile
            for m in range(size):
                block[row, m] = steps[row, first + m]
        _place(block, offset)
        for k in range(len(targets)):
            target = (targets[k, 0], targets[k, 1], targets[k, 2], targets[k, 3], targets[k, 4])
            _add(block, target, sin_tilt, is_slope)
        _factor(block)
        for row in range(10):
            for m in range(size):
                result[row, first + m] = block[_A00 + row, m]
    return result
