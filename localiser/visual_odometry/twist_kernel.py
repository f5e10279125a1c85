"""The inner loops of following edges, compiled by numba: imported only once edges are followed.

An edge at bearing b and inverse range ρ (1/m) from the first camera is seen from the second, which moved by c, at

    d = (sin b, -cos b) - ρ c,    b' = atan2(d_x, -d_z) + turn,    ρ' = ρ / |d|

Inverse, because the foot of an edge is seen at a depression whose tangent is h ρ, so that its error is one of ρ; and
because ρ = 0 is a far edge like any other, which shows the turn and nothing else. With c = 0 that is [Taylor06] eq. 13,
with no turn and c along the axis it is eq. 9-11.

E edges in the first frame, F in the second, P pairs of them, M links, K common errors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.geometry.compiled import compiled, part

_ROUNDS, _STEPS, _SMALL_STEP = 10, 3, 1e-5
_LEAST_WEIGHT = 1e-6  # keeps the equations of an edge that tells nothing solvable
_FAR_SIGMAS = 5.0


class Frame(NamedTuple):
    """What one frame says of its edges, as in `sights.Sights`: measured, sigma (E, 2); common (E, 2, K)."""

    measured: Array
    sigma: Array
    common: Array


class Belief(NamedTuple):
    """Of the twist: mean (3,), information (3, 3). on_floor: whether lower ends may be feet."""

    mean: Array
    information: Array
    on_floor: bool


class Model(NamedTuple):
    """What edges are like: the constants of `pairs`, and how likely a lower end is a foot by its inverse range.

    uneven: sigma of the height of feet, each its own, over the camera's height. new_density: of the second bearing of
    an edge that is new, over the odds that it is not.
    """

    hung_share: float
    neighbour_share: float
    neighbour_sigma: float
    typical: float
    spread: float
    uneven: float
    new_density: float
    floor_inverse: Array
    floor_share: Array


# -- two views of one edge --------------------------------------------------------------------------------------------


@compiled
def camera_moved(twist: Array, mount: Array) -> tuple[float, float, Array]:
    """Return where a camera at `mount` gets to, x and z in its own frame, and ∂(x, z)/∂twist (2, 3).

    mount: (5,) right, backward, yaw of the camera on the robot before; how far it moves on the robot until the second
    image, right and backward in the robot frame. The robot moves by ∫ R(ψ t) dt (right, backward) over the unit of
    time, an arc.
    """
    turn = twist[2]
    if abs(turn) < 1e-4:
        along, across = 1.0 - turn**2 / 6.0, turn / 2.0
        d_along, d_across = -turn / 3.0, 0.5 - turn**2 / 8.0
    else:
        along, across = np.sin(turn) / turn, (1.0 - np.cos(turn)) / turn
        d_along = (np.cos(turn) - along) / turn
        d_across = (np.sin(turn) - across) / turn
    sin, cos = np.sin(turn), np.cos(turn)
    x = along * twist[0] + across * twist[1] + (cos - 1.0) * mount[0] + sin * mount[1]
    z = along * twist[1] - across * twist[0] - sin * mount[0] + (cos - 1.0) * mount[1]
    right, back = cos * mount[3] + sin * mount[4], cos * mount[4] - sin * mount[3]
    x += right
    z += back
    jac = np.empty((2, 3))
    jac[0, 0], jac[0, 1], jac[1, 0], jac[1, 1] = along, across, -across, along
    jac[0, 2] = d_along * twist[0] + d_across * twist[1] - sin * mount[0] + cos * mount[1] + back
    jac[1, 2] = d_along * twist[1] - d_across * twist[0] - cos * mount[0] - sin * mount[1] - right
    sin, cos = np.sin(mount[2]), np.cos(mount[2])
    for column in range(3):
        right, back = jac[0, column], jac[1, column]
        jac[0, column], jac[1, column] = cos * right - sin * back, sin * right + cos * back
    return cos * x - sin * z, sin * x + cos * z, jac


@compiled
def seen_from(bearing: float, inverse: float, x: float, z: float, turn: float) -> tuple[float, float, float, float]:
    """Return where a camera that moved to (x, z) and turned sees an edge: bearing, and d_x, d_z, |d|² of its ray."""
    right = np.sin(bearing) - inverse * x
    back = -np.cos(bearing) - inverse * z
    return np.arctan2(right, -back) + turn, right, back, max(right * right + back * back, 1e-12)


@part
def _wrapped(angle: float) -> float:
    return float(angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi)))


# -- how likely a pair is ---------------------------------------------------------------------------------------------


@part
def _by_common(common: Array, unknown: Array) -> float:
    """Return what common errors add up to: those after the twist in `unknown` (3 + K,), each times `common` (K,)."""
    total = 0.0
    for k in range(len(common)):
        total += common[k] * unknown[3 + k]
    return total


@part
def interpolated(x: float, at: Array, value: Array) -> float:
    """Return what `np.interp` does, which takes a second to compile."""
    last = len(at) - 1
    if x < at[0]:
        return float(value[0])
    if x >= at[last]:
        return float(value[last])
    j = 0
    while x >= at[j + 1]:
        j += 1
    if x == at[j]:
        return float(value[j])
    return float((value[j + 1] - value[j]) / (at[j + 1] - at[j]) * (x - at[j]) + value[j])


@part
def pair_odds(  # noqa: PLR0912, PLR0915  (one pair after another, step by step)
    pairs: NDArray[np.int64],
    look: Array,
    usable: NDArray[np.bool_],
    one: Frame,
    two: Frame,
    unknown: Array,
    cov: Array,
    mount: Array,
    model: Model,
    on_floor: bool,
) -> Array:
    """Return of each pair (P, 3): odds of being one edge, that its bearings are right, that its ends are feet.

    unknown, cov: (3 + K,), (3 + K, 3 + K) twist and common errors, as far as they are known.
    """
    twist = unknown[:3]
    terms, spread = len(unknown) - 3, model.spread
    x, z, by_twist = camera_moved(twist, mount)
    sin, cos = np.sin(twist[2]), np.cos(twist[2])
    back_x, back_z = -(cos * x - sin * z), -(sin * x + cos * z)
    result = np.zeros((len(pairs), 3))
    slope, column = np.empty(3), np.empty(2)
    reach = _FAR_SIGMAS * (model.neighbour_sigma + np.sqrt(cov[2, 2]))
    moved = np.sqrt(x**2 + z**2) + _FAR_SIGMAS * np.sqrt(cov[0, 0] + cov[1, 1])
    most = model.typical + _FAR_SIGMAS * spread
    for p in range(len(pairs)):
        e, f = pairs[p, 0], pairs[p, 1]
        bearing, bearing_sigma = one.measured[e, 0], one.sigma[e, 0]
        # No edge is so near that it moves this far: most pairs end here.
        nearest = max(most, 0.0 if np.isnan(one.measured[e, 1]) else 1.5 * one.measured[e, 1])
        if not usable[p] or abs(_wrapped(two.measured[f, 0] - bearing - twist[2])) > reach + nearest * moved:
            continue
        # The feet in both frames, as one inverse range from the first camera, and how well they agree.
        foot, foot_var, agreement = one.measured[e, 1], one.sigma[e, 1] ** 2, 1.0
        common = one.common[e, 1]
        later = two.measured[f, 1] - _by_common(two.common[f, 1], unknown)
        foot -= _by_common(common, unknown)
        if not np.isnan(later):
            _, _, _, square = seen_from(two.measured[f, 0], later, back_x, back_z, -twist[2])
            later /= np.sqrt(square)
            later_var = two.sigma[f, 1] ** 2
            if np.isnan(foot):
                foot, foot_var, common = later, later_var, two.common[f, 1]
            else:
                narrow = foot_var + later_var
                loose = narrow + spread**2
                agreement = np.sqrt(loose / narrow) * np.exp(-0.5 * (later - foot) ** 2 * (1.0 / narrow - 1.0 / loose))
                foot = (foot * later_var + later * foot_var) / narrow
                foot_var = foot_var * later_var / narrow
        share = 0.0
        if not np.isnan(foot):
            foot_var += (model.uneven * foot) ** 2
            for k in range(terms):
                for m in range(terms):
                    foot_var += common[k] * cov[3 + k, 3 + m] * common[m]
            if on_floor:
                share = interpolated(foot, model.floor_inverse, model.floor_share)
        # Two readings of the lower end, each with a sharp bearing and with that of a neighbour.
        sharp = foot_sharp = total = 0.0
        for reading in range(2):
            if reading == 0:
                if share <= 0.0:
                    continue
                inverse, variance, weight = foot, foot_var, share * agreement
            else:
                inverse = model.typical if np.isnan(foot) else max(model.typical, foot)
                # What hangs keeps its height, so that its lower ends agree as well as feet do; the hidden need not.
                variance, weight = spread**2, (1.0 - share) * (model.hung_share * agreement + 1.0 - model.hung_share)
            expected, right, back, square = seen_from(bearing, inverse, x, z, twist[2])
            column[0], column[1] = -back / square, right / square
            by_bearing = column[0] * np.cos(bearing) + column[1] * np.sin(bearing)
            by_inverse = -(column[0] * x + column[1] * z)
            for k in range(3):
                slope[k] = -inverse * (column[0] * by_twist[0, k] + column[1] * by_twist[1, k])
            slope[2] += 1.0
            variance = two.sigma[f, 0] ** 2 + (by_bearing * bearing_sigma) ** 2 + by_inverse**2 * variance
            for k in range(3):
                for m in range(3):
                    variance += slope[k] * cov[k, m] * slope[m]
            residual = _wrapped(two.measured[f, 0] - expected)
            near = (1.0 - model.neighbour_share) * weight * np.exp(-0.5 * residual**2 / variance) / np.sqrt(variance)
            variance += model.neighbour_sigma**2
            wide = model.neighbour_share * weight * np.exp(-0.5 * residual**2 / variance) / np.sqrt(variance)
            sharp += near
            total += near + wide
            if reading == 0:
                foot_sharp = near
        result[p, 0] = look[p] * total / np.sqrt(2.0 * np.pi) / model.new_density
        if total > 0.0:
            result[p, 1] = sharp / total
        if sharp > 0.0:
            result[p, 2] = foot_sharp / sharp
    return result


@compiled
def one_to_one(pairs: NDArray[np.int64], odds: Array, firsts: int, seconds: int) -> NDArray[np.int64]:
    """Return the indices of pairs that are likelier than not, the likeliest first, each edge in one pair only."""
    first_taken, second_taken = np.zeros(firsts, dtype=np.bool_), np.zeros(seconds, dtype=np.bool_)
    chosen = np.empty(min(firsts, seconds), dtype=np.int64)
    count = 0
    while count < len(chosen):
        best, highest = -1, 1.0
        for p in range(len(odds)):
            if odds[p] > highest and not first_taken[pairs[p, 0]] and not second_taken[pairs[p, 1]]:
                best, highest = p, odds[p]
        if best < 0:
            break
        first_taken[pairs[best, 0]] = second_taken[pairs[best, 1]] = True
        chosen[count] = best
        count += 1
    return chosen[:count]


# -- least squares ----------------------------------------------------------------------------------------------------


@compiled
def invert(matrix: Array) -> None:
    """Invert a symmetric positive definite matrix (U, U) in place, by Gauss-Jordan: small, so no library is called."""
    size = len(matrix)
    for k in range(size):
        pivot = matrix[k, k]
        matrix[k, k] = 1.0
        for j in range(size):
            matrix[k, j] /= pivot
        for i in range(size):
            if i == k:
                continue
            factor = matrix[i, k]
            matrix[i, k] = 0.0
            for j in range(size):
                matrix[i, j] -= factor * matrix[k, j]


@part
def _equations(
    one: Frame,
    two: Frame,
    link: NDArray[np.int64],
    b: float,
    rho: float,
    x: float,
    z: float,
    by_twist: Array,
    unknown: Array,
    floor: float,
    model: Model,
    rows: Array,
    by_edge: Array,
    w: Array,
    residual: Array,
) -> None:
    """Set the five equations of one edge: by what all share (5, U) and by the edge (5, 2), weights, residuals (5,).

    Bearing and inverse range in the first frame, the same in the second, and that the inverse range is a typical one.
    A weight is 0 where nothing is measured.
    """
    e, f = link[0], link[1]
    seen, right, back, square = seen_from(b, rho, x, z, unknown[2])
    distance = np.sqrt(square)
    # By the ray d: of the bearing, and of the inverse range ρ / |d|.
    across = (-back / square, right / square)
    shrink = (-right * rho / (square * distance), -back * rho / (square * distance))
    for r in range(5):
        by_edge[r, 0] = by_edge[r, 1] = 0.0
        for k in range(rows.shape[1]):
            rows[r, k] = 0.0
    by_edge[0, 0] = by_edge[1, 1] = by_edge[4, 1] = 1.0
    by_edge[2, 0] = across[0] * np.cos(b) + across[1] * np.sin(b)
    by_edge[2, 1] = -(across[0] * x + across[1] * z)
    by_edge[3, 0] = shrink[0] * np.cos(b) + shrink[1] * np.sin(b)
    by_edge[3, 1] = -(shrink[0] * x + shrink[1] * z) + 1.0 / distance
    for k in range(3):
        rows[2, k] = -rho * (across[0] * by_twist[0, k] + across[1] * by_twist[1, k])
        rows[3, k] = -rho * (shrink[0] * by_twist[0, k] + shrink[1] * by_twist[1, k])
    rows[2, 2] += 1.0
    rows[4, -1] = -1.0
    residual[0], residual[1] = one.measured[e, 0] - b, one.measured[e, 1] - rho
    residual[2], residual[3] = _wrapped(two.measured[f, 0] - seen), two.measured[f, 1] - rho / distance
    residual[4] = unknown[-1] - rho
    # A foot's own height is wrong in both frames alike; taken as two independent errors of twice the variance.
    one_foot_var = one.sigma[e, 1] ** 2 + 2.0 * (model.uneven * one.measured[e, 1]) ** 2
    two_foot_var = two.sigma[f, 1] ** 2 + 2.0 * (model.uneven * two.measured[f, 1]) ** 2
    w[0], w[1] = 1.0 / one.sigma[e, 0] ** 2, floor / one_foot_var
    w[2], w[3] = 1.0 / two.sigma[f, 0] ** 2, floor / two_foot_var
    w[4] = 1.0 / model.spread**2
    for r in range(4):
        common = one.common[e, r] if r < 2 else two.common[f, r - 2]
        for k in range(one.common.shape[2]):
            rows[r, 3 + k] = common[k]
            residual[r] -= common[k] * unknown[3 + k]
        if np.isnan(w[r]) or np.isnan(residual[r]):
            w[r] = residual[r] = 0.0


@compiled
def solve(  # noqa: PLR0912, PLR0915  (the equations of one edge after another)
    one: Frame,
    two: Frame,
    links: NDArray[np.int64],
    weight: Array,
    floor: Array,
    start: Array,
    belief: Belief,
    mount: Array,
    model: Model,
) -> tuple[Array, Array]:
    """Return twist and common errors (3 + K,) that explain links (M, 2) of edges best, and their covariance.

    weight, floor: (M,) 0 … 1, of a link, and of its ends being feet. start: (3,) twist, for Gauss-Newton.

    Unknown are the twist, the K common errors, the typical inverse range μ, and of every edge bearing and inverse range
    (b, ρ). The latter appear in five equations only (bearing and foot in both frames; ρ ~ N(μ, spread²)), and are
    eliminated by the Schur complement, so that a handful of unknowns is left however many edges there are.
    """
    count, terms = len(links), one.common.shape[2]
    size = 4 + terms
    unknown, expected = np.zeros(size), np.zeros(size)
    before, total, gradient, step = np.zeros((size, size)), np.empty((size, size)), np.empty(size), np.empty(size)
    for i in range(3):
        unknown[i], expected[i] = start[i], belief.mean[i]
        for j in range(3):
            before[i, j] = belief.information[i, j]
    for i in range(3, size):
        before[i, i] = 1.0
    unknown[-1] = expected[-1] = model.typical
    before[-1, -1] = 1.0 / model.spread**2
    edge, own, pull = np.empty((count, 2)), np.empty((count, 2, 2)), np.empty((count, 2))
    cross = np.empty((count, 2, size))
    for m in range(count):
        e, f = links[m, 0], links[m, 1]
        foot = two.measured[f, 1] if np.isnan(one.measured[e, 1]) else one.measured[e, 1]
        edge[m, 0], edge[m, 1] = one.measured[e, 0], model.typical if np.isnan(foot) or floor[m] < 0.5 else foot
    rows, by_edge = np.empty((5, size)), np.empty((5, 2))
    w, residual = np.empty(5), np.empty(5)
    for _ in range(_STEPS):
        for i in range(size):
            gradient[i] = 0.0
            for j in range(size):
                total[i, j] = before[i, j]
                gradient[i] += before[i, j] * (expected[j] - unknown[j])
        x, z, by_twist = camera_moved(unknown[:3], mount)
        for m in range(count):
            b, rho = edge[m, 0], edge[m, 1]
            _equations(one, two, links[m], b, rho, x, z, by_twist, unknown, floor[m], model, rows, by_edge, w, residual)
            for a in range(2):
                pull[m, a] = own[m, a, 0] = own[m, a, 1] = 0.0
                for i in range(size):
                    cross[m, a, i] = 0.0
            for r in range(5):
                w[r] *= weight[m]
                if w[r] == 0.0:
                    continue
                for a in range(2):
                    scaled = w[r] * by_edge[r, a]
                    if scaled == 0.0:
                        continue
                    pull[m, a] += scaled * residual[r]
                    for c in range(2):
                        own[m, a, c] += scaled * by_edge[r, c]
                    for i in range(size):
                        cross[m, a, i] += scaled * rows[r, i]
                for i in range(size):
                    scaled = w[r] * rows[r, i]
                    if scaled == 0.0:
                        continue
                    gradient[i] += scaled * residual[r]
                    for j in range(size):
                        total[i, j] += scaled * rows[r, j]
            determinant = own[m, 0, 0] * own[m, 1, 1] - own[m, 0, 1] * own[m, 1, 0]
            own[m, 0, 0], own[m, 1, 1] = own[m, 1, 1] / determinant, own[m, 0, 0] / determinant
            own[m, 0, 1] = own[m, 1, 0] = -own[m, 0, 1] / determinant
            # Schur complement: what the edge leaves to say about what all share.
            for a in range(2):
                for i in range(size):
                    reduced = own[m, a, 0] * cross[m, 0, i] + own[m, a, 1] * cross[m, 1, i]
                    gradient[i] -= reduced * pull[m, a]
                    for j in range(size):
                        total[i, j] -= reduced * cross[m, a, j]
        invert(total)
        is_small = True
        for i in range(size):
            step[i] = 0.0
            for j in range(size):
                step[i] += total[i, j] * gradient[j]
            unknown[i] += step[i]
            is_small = is_small and abs(step[i]) < _SMALL_STEP
        for m in range(count):
            for a in range(2):
                for i in range(size):
                    pull[m, a] -= cross[m, a, i] * step[i]
            for a in range(2):
                edge[m, a] += own[m, a, 0] * pull[m, 0] + own[m, a, 1] * pull[m, 1]
        if is_small:
            break
    cov = np.empty((size - 1, size - 1))
    for i in range(size - 1):
        for j in range(size - 1):
            cov[i, j] = total[i, j]
    return unknown[:-1], cov


# -- pairing and solving in turns -------------------------------------------------------------------------------------


@compiled
def refine(
    pairs: NDArray[np.int64],
    look: Array,
    usable: NDArray[np.bool_],
    one: Frame,
    two: Frame,
    mount: Array,
    belief: Belief,
    start: Array,
    start_var: Array,
    model: Model,
) -> tuple[Array, Array, NDArray[np.int64], Array]:
    """Return what pairing edges and solving for the twist in turns leads to, from a start (3,).

    Twist (3,) and covariance (3, 3), indices of the pairs chosen (M,), and their log-likelihoods (M,).
    """
    size = 3 + one.common.shape[2]
    unknown, cov = np.zeros(size), np.zeros((size, size))
    for k in range(size):
        unknown[k], cov[k, k] = (start[k], start_var[k]) if k < 3 else (0.0, 1.0)
    before, links = np.empty(3), np.empty((0, 2), dtype=np.int64)
    chosen, previous = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    log_likelihood = np.empty(0)
    for _ in range(_ROUNDS):
        found = pair_odds(pairs, look, usable, one, two, unknown, cov, mount, model, belief.on_floor)
        previous, chosen = chosen, one_to_one(pairs, found[:, 0], len(one.measured), len(two.measured))
        count = len(chosen)
        if count == 0:
            break
        settled = len(previous) == count
        weight, floor, log_likelihood = np.empty(count), np.empty(count), np.empty(count)
        links = np.empty((count, 2), dtype=np.int64)
        for m in range(count):
            p = chosen[m]
            odds = found[p, 0]
            log_likelihood[m] = np.log1p(odds)
            weight[m] = max(found[p, 1] * odds / (1.0 + odds), _LEAST_WEIGHT)
            floor[m] = found[p, 2]
            links[m, 0], links[m, 1] = pairs[p, 0], pairs[p, 1]
            settled = settled and previous[m] == p
        for k in range(3):
            before[k] = unknown[k]
        unknown, cov = solve(one, two, links, weight, floor, before, belief, mount, model)
        for k in range(3):
            settled = settled and abs(unknown[k] - before[k]) < 0.1 * np.sqrt(cov[k, k])
        if settled:
            break
    return unknown[:3], cov[:3, :3], chosen, log_likelihood
