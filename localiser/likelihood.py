"""The observation's sum over particles, landmarks and edges as one loop, for numba to compile.

It computes what `observation.EdgeObservation.by_share_plain` does with arrays, in the same steps: landmarks into the
camera, what can be seen, which edges are within the gate, how likely each is, and the shares of inliers. A particle's
result depends on nothing but that particle.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What all particles share in a frame: landmarks, edges and the camera, as the loop takes them.

    landmarks: (L, 5) x, z, bottom and top above the camera (nan where unknown), sigma of the position, all in m.
    edges: (E, 4) compared angle (rad, ascending), its variance (rad²), upright image heights of the lower and upper
    end (-inf, inf where unknown). first: (B,) index of the first edge at or above the lower limit of each of B even
    bins of the angle, which begin at bin_low and are bin_step wide. view: (8,) sine and cosine of the tilt; a_left,
    a_right, e_low, e_high of the image with its margin; shortest length and end tolerance, normalised.
    range_m: nearest, farthest. widest: bound on |tan(bearing)|. gate: reach beyond the landmark's own sigma: how many
    sigmas, and the largest variance of an edge. span: of the compared angle (rad). is_slope: whether that is the lean.
    """

    landmarks: Array
    edges: Array
    first: NDArray[np.int64]
    bin_low: float
    bin_step: float
    view: Array
    range_m: tuple[float, float]
    widest: float
    gate: tuple[float, float]
    span: float
    is_slope: bool


def by_share(scene: Scene, camera_poses: Array, shares: Array) -> Array:
    """Return log p(edges | pose, w_k) (K, N) of camera poses (N, 3) for shares w_k (K,), relative to all clutter."""
    return np.asarray(
        _compiled()(
            np.ascontiguousarray(camera_poses),
            shares,
            scene.landmarks,
            scene.edges,
            scene.first,
            scene.bin_low,
            scene.bin_step,
            scene.view,
            scene.range_m,
            scene.widest,
            scene.gate,
            scene.span,
            scene.is_slope,
        )
    )


def bins_of(angle: Array) -> tuple[NDArray[np.int64], float, float]:
    """Return first (B,), bin_low, bin_step of ascending angles (E,): where edges from an angle on begin."""
    if len(angle) == 0:
        return np.zeros(0, dtype=np.int64), 0.0, 1.0
    count = 8 * len(angle) + 1
    step = max(float(angle[-1] - angle[0]) / (count - 1), 1e-12)
    return np.searchsorted(angle, angle[0] + step * np.arange(count)).astype(np.int64), float(angle[0]), step


def likelihood_loop(  # noqa: PLR0912, PLR0915  (numba compiles one loop best as one function)
    poses: Array,
    shares: Array,
    landmarks: Array,
    edges: Array,
    first: NDArray[np.int64],
    bin_low: float,
    bin_step: float,
    view: Array,
    range_m: tuple[float, float],
    widest: float,
    gate: tuple[float, float],
    span: float,
    is_slope: bool,
) -> Array:
    """Return log p(edges | pose, w_k) (K, N); arguments as in `Scene`. Plain loops, for numba to compile."""
    s, c, a_left, a_right, e_low, e_high, length_min, tolerance = view
    nearest, farthest = range_m[0] ** 2, range_m[1] ** 2
    number = len(edges)
    result = np.zeros((len(shares), len(poses)))
    density = np.zeros(number)
    for n in range(len(poses)):
        x, z = poses[n, 0], poses[n, 1]
        cos, sin = np.cos(poses[n, 2]), np.sin(poses[n, 2])
        density[:] = 0.0
        visible = 0
        for k in range(len(landmarks)):
            dx, dz = landmarks[k, 0] - x, landmarks[k, 1] - z
            squared = dx * dx + dz * dz
            if squared > farthest or squared < nearest:
                continue
            right, ahead = dx * cos - dz * sin, -(dx * sin + dz * cos)
            if ahead <= 0.0 or abs(right) > ahead * widest:
                continue
            tangent = right / ahead

            # The edge from its foot to its top, cut to the image: e is the upright image's height.
            bottom, top = landmarks[k, 2], landmarks[k, 3]
            foot_e, top_e = -np.inf, np.inf
            if not np.isnan(bottom):
                depth = ahead * c - bottom * s
                foot_e = (bottom * c + ahead * s) / depth if depth > 0 else np.copysign(np.inf, bottom)
            if not np.isnan(top):
                depth = ahead * c - top * s
                top_e = (top * c + ahead * s) / depth if depth > 0 else np.copysign(np.inf, top)
            low, high = max(foot_e, e_low), min(top_e, e_high)
            border = a_right if tangent > 0 else a_left
            limit = border / tangent if tangent != 0 else np.inf
            if s > 1e-12:
                high = min(high, (limit - c) / s)
            elif s < -1e-12:
                low = max(low, (limit - c) / s)
            elif c > limit:
                high = -np.inf
            stretch = np.sqrt(1.0 + (s * tangent) ** 2)
            if (high - low) * stretch < length_min:
                continue
            visible += 1

            # The edges near where this landmark is expected.
            if is_slope:
                predicted, per_bearing = np.arctan(s * tangent), s * (1 + tangent**2) / (1 + (s * tangent) ** 2)
            else:
                predicted, per_bearing = np.arctan(tangent), 1.0
            position_var = (per_bearing * landmarks[k, 4]) ** 2 / squared
            reach = gate[0] * np.sqrt(position_var + gate[1])
            start = int((predicted - reach - bin_low) / bin_step)
            if start >= len(first):
                continue
            for e in range(first[max(start, 0)], number):  # a bin may begin a little before the gate
                residual = edges[e, 0] - predicted
                if residual < -reach:
                    continue
                if residual > reach:
                    break
                variance = position_var + edges[e, 1]
                if residual * residual > gate[0] * gate[0] * variance:
                    continue
                # The share of the edge between the landmark's ends, squared.
                covered = 1.0
                bottom_e, upper_e = edges[e, 2], edges[e, 3]
                if bottom_e > -np.inf:
                    inside = min(top_e + tolerance, upper_e) - max(foot_e - tolerance, bottom_e)
                    covered = min(max(inside / (upper_e - bottom_e), 0.0), 1.0)
                    if covered == 0.0:
                        continue
                normal = np.exp(-0.5 * residual * residual / variance) / np.sqrt(2 * np.pi * variance)
                density[e] += normal * covered * covered

        each = span / max(visible, 1)
        for k in range(len(shares)):
            product, total = 1.0, 0.0  # one logarithm for many factors, as long as their product is a number
            for e in range(number):
                product *= 1.0 + shares[k] * (density[e] * each - 1.0)
                if product > 1e200 or product < 1e-200:
                    total += np.log(product)
                    product = 1.0
            result[k, n] = total + np.log(product)
    return result


@cache
def _compiled() -> Any:
    """Return the loop compiled; kept on disk, so that only the first run ever waits for it."""
    import numba

    return numba.njit(cache=True, error_model="numpy")(likelihood_loop)
