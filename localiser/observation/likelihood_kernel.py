"""The loops of `edge_observation`, compiled by numba when this module is imported and its functions are first called.

The particles of a cell share the list of landmarks that can be in view. A block of particles is processed one landmark
at a time. Particles of one cell expect it at nearly the same angle, so the edges near it are nearly the same for all of
them: each is weighed for the whole block at once. The inner loops run along rows of one small array of constant shape.
Only then does the compiler know that rows do not overlap, and uses vector instructions. The length of a row is always a
multiple of `LANES`, so every particle goes through the same instructions, independent of its neighbours.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, Indices
from localiser.geometry.angle_kernel import arctan, cos_sin_near
from localiser.geometry.compiled import entry, inlined
from localiser.observation.inlier_rate import INLIER_RATES

LANES = 8  # float64 in a vector register
LEAST_VECTORS = 2  # vectors, for which a vector loop is entered
BLOCK = 64  # particles looked at together
RATES = len(INLIER_RATES)  # of each view
UNKNOWN_M = 1e8  # heights beyond this are not known
SAFE = 1e150  # a product is put aside when it grows beyond

GATE_SIGMAS = 6.0  # beyond this a normal density is below 1e-8 of its peak: nothing beside clutter

# exp(y) = exp(y/16)^16, the inner one as a polynomial between the gate and 0: 2e-6 of its value.
_LEAST = -0.5 * GATE_SIGMAS**2 / 16
_SERIES = np.polynomial.Chebyshev.interpolate(np.exp, 6, domain=[_LEAST, 0.0])
_X0, _X1, _X2, _X3, _X4, _X5, _X6 = (float(power) for power in _SERIES.convert(kind=np.polynomial.Polynomial).coef)
_HALF_PI, _LOG_TWO, _ROOT_TWO = np.pi / 2, float(np.log(2.0)), float(np.sqrt(2.0))
_FRACTION, _ONE = (1 << 52) - 1, 1023 << 52  # bits of a float64: its fraction; 1.0

# Rows of a block: camera poses; one landmark as it is seen from them; one edge beside it; how many landmarks are seen.
# In one array, so that the compiler knows that they do not overlap.
_X, _Z, _HEADING, _YAW, _COS, _SIN = range(6)
_ANGLE, _VARIANCE, _FOOT, _TOP, _PER_VISIBLE, _FIRST, _END, _SCALE = range(6, 14)
_RESIDUAL, _SPREAD, _COVERED, _IS_PAIR, _AT_FOOT, _AT_TOP, _DENSITY, _RATIO = range(14, 22)
_OPEN = 22
_SEEN = 23  # and below, for each view
# Columns of edges.
_MEASURED, _VAR, _LOW, _HIGH, _PER_LENGTH, _ROOM_LOW, _ROOM_HIGH, _PEAK_LOW, _PEAK_HIGH = range(9)
_PER_SIGMA_LOW, _PER_SIGMA_HIGH, _POLARITY, _IDENTITY = range(9, 13)


@inlined
def _turn(block: Array, lanes: int) -> None:
    """Write cosine and sine of the headings: their series within an eighth of a turn, to the last digits."""
    for m in range(lanes):
        quarter = np.floor(block[_HEADING, m] * (2 / np.pi) + 0.5)
        d = block[_HEADING, m] - quarter * _HALF_PI
        block[_COS, m], block[_SIN, m] = cos_sin_near(quarter, d)


@inlined
def _place(poses: Array, order: Indices, first: int, size: int, lanes: int, offset: Any, block: Array) -> None:
    """Write the camera poses of particles order[first : first + size], of which none has seen a landmark yet.

    The lanes beyond repeat the last one.
    """
    right, back, yaw = offset
    for m in range(lanes):
        n = order[first + min(m, size - 1)]
        for row in range(_COS):
            block[row, m] = poses[n, row]
        for row in range(_SEEN, len(block)):
            block[row, m] = 0.0
    _turn(block, lanes)
    for m in range(lanes):
        block[_X, m] += block[_COS, m] * right + block[_SIN, m] * back
        block[_Z, m] += block[_COS, m] * back - block[_SIN, m] * right
        block[_HEADING, m] += block[_YAW, m] + yaw
    _turn(block, lanes)


@inlined
def _look(block: Array, lanes: int, one: Any, position_var: float, seen_in: Any) -> None:
    """Write how a block of cameras sees one landmark: the expected angle, its variance, ends, bins of edges near it.

    The same as `landmarks.sight`, with every division by the image's border multiplied out. Cameras that have it behind
    them expect no angle. For those that do not see it, it lies above all edges, and is in the open with probability 0.
    one: the landmark as the map has it. position_var: its variance (m²). seen_in: see `edge_observation.kernel_inputs`.
    """
    image, (nearest, farthest, open_sq, widest), (bin_low, per_bin, last_bin), largest_var, is_slope = seen_in
    s, c, a_left, a_right, e_low, e_high, length_min, height_m = image
    x, z, bottom, top = one[0], one[1], one[2] - height_m, one[3] - height_m
    for m in range(lanes):
        dx, dz = x - block[_X, m], z - block[_Z, m]
        right, ahead = dx * block[_COS, m] - dz * block[_SIN, m], -(dx * block[_SIN, m] + dz * block[_COS, m])
        aside = abs(right)
        ahead_sq, square = ahead * ahead, dx * dx + dz * dz
        inclined_sq = s * s * right * right
        stretched = ahead_sq + inclined_sq  # ahead² (1 + (s tan b)²)

        # Heights of both ends in the upright image, by one division.
        foot_depth, top_depth = ahead * c - bottom * s, ahead * c - top * s
        foot_positive, top_positive = (foot_depth if foot_depth > 0 else 1.0), (top_depth if top_depth > 0 else 1.0)
        per = 1.0 / (foot_positive * top_positive)
        foot_e = (bottom * c + ahead * s) * top_positive * per
        top_e = (top * c + ahead * s) * foot_positive * per
        foot_e = foot_e if foot_depth > 0 else (np.inf if bottom > 0 else -np.inf)
        top_e = top_e if top_depth > 0 else (np.inf if top > 0 else -np.inf)
        foot_e = foot_e if bottom > -UNKNOWN_M else -np.inf
        top_e = top_e if top < UNKNOWN_M else np.inf

        # Long enough between the image's lower and upper border, and from there to the left or right one.
        low, high = (foot_e if foot_e > e_low else e_low), (top_e if top_e < e_high else e_high)
        shortest = length_min * length_min
        length = high - low
        room = (a_right if right > 0 else -a_left) * ahead - aside * (c + s * (low if s >= 0 else high))
        visible = (square <= farthest) & (square >= nearest) & (ahead > 0) & (aside <= ahead * widest)
        visible = visible & (length > 0) & (length * length * stretched >= shortest * ahead_sq)
        visible = visible & (room >= 0) & (room * room * stretched >= shortest * ahead_sq * inclined_sq)

        across = abs(s) * aside if is_slope else aside
        steep = across > ahead
        numerator, denominator = (ahead if steep else across), (across if steep else ahead)
        per = 1.0 / (denominator * square)
        angle = arctan(numerator * square * per)
        angle = _HALF_PI - angle if steep else angle
        negative = ((right < 0) != (s < 0)) if is_slope else right < 0
        angle = -angle if negative else angle
        # d(lean)/d(bearing) = s · square / stretched
        per_range_sq = s * s * square / (stretched * stretched) if is_slope else denominator * per
        variance = position_var * per_range_sq

        reach = GATE_SIGMAS * np.sqrt(variance + largest_var)
        first, last = (angle - reach - bin_low) * per_bin, (angle + reach - bin_low) * per_bin + 2.0
        first, last = (first if first > 0 else 0.0), (last if last > 0 and visible else 0.0)
        first, last = (first if first < last_bin and visible else last_bin), (last if last < last_bin else last_bin)
        block[_FIRST, m], block[_END, m] = first, last
        block[_ANGLE, m], block[_VARIANCE, m] = (angle if ahead > 0 else np.inf), variance
        nearness = open_sq / square if square > open_sq else 1.0
        block[_OPEN, m] = nearness * nearness if visible else 0.0
        foot_e = foot_e if foot_e > e_low else -np.inf
        block[_FOOT, m], block[_TOP, m] = (foot_e if visible else np.inf), (top_e if top_e < e_high else np.inf)
        block[_PER_VISIBLE, m] = 1.0 / (length if length > 0 else 1.0)


@inlined
def _count(block: Array, lanes: int, visibility: Array, k: int) -> None:
    """Count landmark k for those that see it, by how visible it is."""
    for view in range(len(visibility)):
        for m in range(lanes):
            block[_SEEN + view, m] += visibility[view, k] * block[_OPEN, m]


@inlined
def _normal(y: float) -> float:
    """Return exp(16 y) for y ≤ 0, at least e^-18."""
    y = y if y > _LEAST else _LEAST
    value = _X0 + y * (_X1 + y * (_X2 + y * (_X3 + y * (_X4 + y * (_X5 + y * _X6)))))
    value *= value
    value *= value
    value *= value
    return value * value


@inlined
def _end(
    measured: Any, room: float, peak: float, block: Array, lanes: int, rows: Any, missed: float, is_unknown: bool
) -> None:
    """Write how much likelier one end of an edge is if it is the landmark's: *Ends* in docs/observation.md."""
    e, per_sigma = measured
    expected, at = rows
    for m in range(lanes):
        short = min(room * block[_PER_VISIBLE, m], 1.0)
        short = missed * short if np.isfinite(block[expected, m]) else short
        block[at, m] = 1.0 if is_unknown else short
    if peak > 0:
        for m in range(lanes):
            off = (e - block[expected, m]) * per_sigma
            block[at, m] += peak * _normal(-0.5 / 16 * off * off)


@inlined
def _meet(edge: Any, block: Array, lanes: int, tolerance: float) -> int:
    """Compare an edge with the landmark, seen by each particle; return of how many they are a pair."""
    pairs = 0
    for m in range(lanes):
        residual, spread = edge[_MEASURED] - block[_ANGLE, m], edge[_VAR] + block[_VARIANCE, m]
        inside = min(block[_TOP, m], edge[_HIGH]) - max(block[_FOOT, m], edge[_LOW]) + 2 * tolerance
        is_pair = (residual * residual < GATE_SIGMAS**2 * spread) & (inside > 0)
        block[_RESIDUAL, m], block[_SPREAD, m] = residual, spread
        block[_COVERED, m] = inside * edge[_PER_LENGTH]
        block[_IS_PAIR, m] = 1.0 if is_pair else 0.0
        pairs += is_pair
    return pairs


@inlined
def _weigh(edge: Any, block: Array, lanes: int, missed: float, hidden: Any, alike: float) -> None:
    """Write √(2π) c_el N(q_e; q_l, σ_el²) of an edge and the landmark, 0 where they are no pair.

    c_el is the squared part of the edge that lies between the landmark's ends, times `_end` for each, and polarity.
    """
    low, high = (edge[_LOW], edge[_PER_SIGMA_LOW]), (edge[_HIGH], edge[_PER_SIGMA_HIGH])
    _end(low, edge[_ROOM_LOW], edge[_PEAK_LOW], block, lanes, (_FOOT, _AT_FOOT), missed, hidden[0])
    _end(high, edge[_ROOM_HIGH], edge[_PEAK_HIGH], block, lanes, (_TOP, _AT_TOP), missed, hidden[1])
    for m in range(lanes):
        per = 1.0 / block[_SPREAD, m]
        covered = min(block[_COVERED, m], 1.0)
        agreement = _normal(-0.5 / 16 * block[_RESIDUAL, m] * block[_RESIDUAL, m] * per) * covered * covered
        density = agreement * block[_AT_FOOT, m] * block[_AT_TOP, m] * alike * np.sqrt(per)
        block[_DENSITY, m] = density if block[_IS_PAIR, m] > 0 else 0.0


@inlined
def _add_up(e: int, k: int, visibility: Array, block: Array, lanes: int, density: Array) -> None:
    """Add the densities of edge e and landmark k to `density`, by how visible the landmark is."""
    for view in range(len(visibility)):
        for m in range(lanes):
            density[view, e, m] += visibility[view, k] * block[_OPEN, m] * block[_DENSITY, m]


@inlined
def _multiply(
    density: Array, scale: Any, block: Array, lanes: int, odds: Array, factor: Array, log_factor: Array
) -> None:
    """Multiply the factors by 1 + odds · ratio of one edge, and put the logarithms of large ones aside.

    scale: by which its density, 0 from then on, becomes the ratio, and whether the landmarks in view share it. The
    factor is 1 for particles that the edge is not near, so that they stay as they are, to the last bit.
    """
    per_density, is_shared = scale
    for m in range(lanes):
        block[_RATIO, m] = density[m] * per_density
        density[m] = 0.0
    if is_shared:
        for m in range(lanes):
            block[_RATIO, m] *= block[_SCALE, m]
    for k in range(RATES):
        for m in range(lanes):
            factor[k, m] *= 1.0 + odds[k] * block[_RATIO, m]
    large = 0
    for m in range(lanes):
        large += factor[RATES - 1, m] > SAFE
    if large > 0:
        for m in range(lanes):
            if factor[RATES - 1, m] > SAFE:
                for k in range(RATES):
                    log_factor[k, m] += np.log(factor[k, m])
                    factor[k, m] = 1.0


@inlined
def _logarithm(value: Array, bits: Indices, mantissa: Array, mantissa_bits: Indices, result: Array) -> None:
    """Add the logarithms of finite values ≥ 1 to `result`, to the last digits. bits, mantissa_bits: the same memory."""
    for i in range(len(value)):
        mantissa_bits[i] = (bits[i] & _FRACTION) | _ONE
    for i in range(len(value)):
        m = mantissa[i]
        exponent = float((bits[i] >> 52) - 1023)
        high = m > _ROOT_TWO
        m, exponent = (0.5 * m if high else m), (exponent + 1.0 if high else exponent)
        s = (m - 1.0) / (m + 1.0)  # log m = 2 artanh s, |s| ≤ 0.172
        v = s * s
        v2 = v * v
        v4 = v2 * v2
        low_half = (1 + v / 3) + v2 * (1 / 5 + v / 7)
        high_half = (1 / 9 + v / 11) + v2 * (1 / 13 + v / 15) + v4 * (1 / 17 + v / 19)
        result[i] += exponent * _LOG_TWO + 2 * s * (low_half + v4 * high_half)


@entry
def log_products(
    poses: Array, cells: Any, visibility: Array, odds: Array, is_inlier_rate: bool, rare: Array, inputs: Any
) -> Array:
    """Return the log-likelihood (V, RATES, N) in V views of every pose (N, 4), relative to clutter.

    The pose has n landmarks in view. With d_e = span Σ_l c_el N(q_e; q_l, σ_el²) / clutter_e, an edge's density
    relative to clutter, which only edges have that some landmark comes near, it is

        log Π_e (1 + o_k d_e / n) / (1 + o_k)    for inlier rates, o_k = w_k / (1 - w_k)
        log Π_e (1 + o_k d_e) / (1 + o_k n)      for detection rates, o_k = p_k / E

    where a landmark counts for the probability with which it is visible, in d_e and in n, and no wall before it. An
    edge of known identity belongs to that landmark or is clutter: n is 1 for it at inlier rates.

    cells: of `edge_observation.in_cells`. visibility: (V, L) this probability. odds: (RATES,) o_k of ascending rates.
    rare: (E,) 1 / clutter_e. inputs: the image and the map, see `edge_observation.kernel_inputs`.
    """
    order, run, start, item = cells
    offset, map_scale, landmarks, edges, first, seen_in, ends, span = inputs
    block = np.ones((_SEEN + len(visibility), BLOCK))
    density, is_near = np.zeros((len(visibility), len(edges), BLOCK)), np.zeros(len(edges), np.bool_)
    factor, log_factor, mantissa = np.ones((RATES, BLOCK)), np.zeros((RATES, BLOCK)), np.ones(RATES * BLOCK)
    result, per_density = np.empty((len(visibility), RATES, len(poses))), span / np.sqrt(2 * np.pi)
    log_unseen = np.log1p(odds)  # at inlier rates
    for c in range(len(run) - 1):
        for n in range(run[c], run[c + 1], BLOCK):
            size = min(BLOCK, run[c + 1] - n)
            lanes = max((size + LANES - 1) // LANES, LEAST_VECTORS) * LANES
            _place(poses, order, n, size, lanes, offset, block)
            for k in item[start[c] : start[c + 1]]:
                one, sigma_m = landmarks[k], map_scale * landmarks[k, 4]
                hidden = one[2] <= -UNKNOWN_M, one[3] >= UNKNOWN_M
                _look(block, lanes, one, sigma_m * sigma_m, seen_in)
                _count(block, lanes, visibility, k)
                # Edges in these bins are near for any of the particles, and perhaps some more.
                lowest, highest = np.int64(block[_FIRST, 0]), np.int64(block[_END, 0])
                for m in range(lanes):
                    lowest, highest = min(lowest, np.int64(block[_FIRST, m])), max(highest, np.int64(block[_END, m]))
                for e in range(first[lowest], first[highest]):
                    edge = edges[e]
                    if (edge[_IDENTITY] < 0 or edge[_IDENTITY] == k) and _meet(edge, block, lanes, ends[0]) > 0:
                        _weigh(edge, block, lanes, ends[1], hidden, 1.0 + edge[_POLARITY] * one[5])
                        _add_up(e, k, visibility, block, lanes, density)
                        is_near[e] = True

            for view in range(len(visibility)):
                for m in range(BLOCK):
                    block[_SCALE, m] = 1.0 / max(block[_SEEN + view, m], 1.0)
                factor[:], log_factor[:] = 1.0, 0.0
                for e in range(len(edges)):
                    if is_near[e]:
                        scale = per_density * rare[e], is_inlier_rate and edges[e, _IDENTITY] < 0
                        _multiply(density[view, e], scale, block, lanes, odds, factor, log_factor)
                        is_near[e] = view + 1 < len(visibility)  # else it is near no particle of the next block yet
                values = factor.ravel()
                _logarithm(values, values.view(np.int64), mantissa, mantissa.view(np.int64), log_factor.ravel())
                for k in range(RATES):
                    for m in range(size):
                        unseen = log_unseen[k] if is_inlier_rate else np.log1p(odds[k] * block[_SEEN + view, m])
                        result[view, k, order[n + m]] = log_factor[k, m] - len(edges) * unseen
    return result


@entry
def associate(pose: Array, cov: Array, item: NDArray[np.int32], inputs: Any) -> tuple[Array, Array]:
    """Return the landmarks that a pose (3,) sees, and the edges near them.

    Rows (K, 6) of landmarks: index, expected angle (rad), how fast it changes as the landmark is moved aside (rad/m),
    its variances by the map and by the pose (rad²), probability that no wall is before it. Rows (P, 5) of pairs: row of
    the landmark, row of the edge, residual (rad), odds from this pose and over all (see `association.Association`).

    cov: (3, 3) of the pose, by which the angle a, as it changes by per_m, varies by g cov gᵀ. d is from the camera to
    the landmark, o from the robot to the camera:

        g = per_m |d| (d_z, -d_x, |d|² + d·o) / |d|²

    item: landmarks to look at. inputs: as for `log_products`.
    """
    offset, map_scale, landmarks, edges, _, seen_in, ends, span = inputs
    block, poses = np.ones((_SEEN, 2)), np.zeros((2, 4))
    poses[:, :3] = pose
    seen, pairs = np.empty((len(item), 6)), np.empty((len(item) * len(edges), 5))
    shown, used, in_view, per_density = 0, 0, 0.0, span / np.sqrt(2 * np.pi)
    _place(poses, np.arange(2), 0, 2, 2, offset, block)
    for k in item:
        one, sigma_m = landmarks[k], map_scale * landmarks[k, 4]
        hidden = one[2] <= -UNKNOWN_M, one[3] >= UNKNOWN_M
        _look(block, 2, one, 1.0, seen_in)
        angle, per_m_sq, is_open = block[_ANGLE, 0], block[_VARIANCE, 0], block[_OPEN, 0]
        if is_open == 0:
            continue
        dx, dz = one[0] - block[_X, 0], one[1] - block[_Z, 0]
        square = dx * dx + dz * dz
        turned = square + dx * (block[_X, 0] - pose[0]) + dz * (block[_Z, 0] - pose[1])
        by_pose = dz * dz * cov[0, 0] + dx * dx * cov[1, 1] + turned * turned * cov[2, 2]
        by_pose += 2.0 * (dz * turned * cov[0, 2] - dx * turned * cov[1, 2] - dx * dz * cov[0, 1])
        by_map, by_pose = sigma_m * sigma_m * per_m_sq, max(by_pose, 0.0) * per_m_sq / square
        block[_VARIANCE, 0], block[_VARIANCE, 1] = by_map, by_map + by_pose
        for e in range(len(edges)):
            edge = edges[e]
            if (edge[_IDENTITY] < 0 or edge[_IDENTITY] == k) and _meet(edge, block, 2, ends[0]) > 0:
                _weigh(edge, block, 2, ends[1], hidden, 1.0 + edge[_POLARITY] * one[5])
                pairs[used, 0], pairs[used, 1], pairs[used, 2] = shown, e, block[_RESIDUAL, 0]
                for m in range(2):
                    pairs[used, 3 + m] = per_density * is_open * block[_DENSITY, m]
                used += 1
        seen[shown, 0], seen[shown, 1], seen[shown, 2] = k, angle, np.sqrt(per_m_sq)
        seen[shown, 3], seen[shown, 4], seen[shown, 5] = by_map, by_pose, is_open
        shown, in_view = shown + 1, in_view + is_open
    for p in range(used):
        if edges[int(pairs[p, 1]), _IDENTITY] < 0:
            pairs[p, 3:] /= max(in_view, 1.0)
    return seen[:shown], pairs[:used]
