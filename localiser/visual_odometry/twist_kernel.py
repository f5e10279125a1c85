"""The loops of following edges, compiled by numba: imported only once edges are followed.

An edge at bearing b and inverse range ρ (1/m) from the first camera is seen from the second, which moved by c, at

    d = (sin b, -cos b) - ρ c,    b' = atan2(d_x, -d_z) + turn,    ρ' = ρ / |d|

Inverse, because the foot of an edge is seen at a depression whose tangent is h ρ, so that its error is one of ρ; and
because ρ = 0 is a far edge like any other, which shows the turn and nothing else. With c = 0 that is [Taylor06] eq. 13,
with no turn and c along the axis it is eq. 9-11.

E edges in the first image, F in the second, P pairs of them, M chosen, K common errors, U = 3 + K + 1 unknowns: motion,
common errors, typical inverse range.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.geometry.compiled import compiled, part
from localiser.visual_odometry.two_images import TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD, TwoImages

Indices = NDArray[np.int64]

FLOOR_SHARE = 0.5  # of the lower ends that are feet
HUNG_SHARE = 0.5  # of lower ends that are no feet, that hang at a height of their own; something hides the rest
START_SIGMA = 2e-3, 2e-3, 5e-4  # how far a start of the search may be off: right, backward (m), turn (rad)
TYPICAL_INFORMATION = TYPICAL_SPREAD**-2
_ROUNDS, _STEPS, _SMALL_STEP = 10, 3, 1e-5
_FAR_SIGMAS, _FAR_RAD = 5.0, np.radians(0.3)  # beyond which a pair is none: of what is known, and of bearings


# -- two views of one edge --------------------------------------------------------------------------------------------


@compiled
def camera_moved(motion: Array, mount: Array) -> tuple[float, float, Array]:
    """Return where a camera at `mount` gets to, x and z in its own frame, and ∂(x, z)/∂motion (2, 3).

    motion: (3,) of the robot. mount: (5,) right, backward, yaw of the camera on the robot before; how far it moves on
    the robot until the second image, right and backward in the robot frame. As complex numbers x + i z, a turn by ψ is
    a factor of exp(-i ψ).
    """
    place, moved = complex(mount[0], mount[1]), complex(mount[3], mount[4])
    turned, to_camera = np.exp(-1j * motion[2]), np.exp(1j * mount[2])
    camera = to_camera * (complex(motion[0], motion[1]) + (turned - 1.0) * place + turned * moved)
    by_turn = -1j * to_camera * turned * (place + moved)
    jac = np.empty((2, 3))
    jac[0, 0], jac[0, 1], jac[0, 2] = to_camera.real, -to_camera.imag, by_turn.real
    jac[1, 0], jac[1, 1], jac[1, 2] = to_camera.imag, to_camera.real, by_turn.imag
    return camera.real, camera.imag, jac


@compiled
def seen_from(bearing: float, inverse: float, x: float, z: float, turn: float) -> tuple[float, float, float, float]:
    """Return where a camera that moved to (x, z) and turned sees an edge: bearing, and d_x, d_z, |d| of its ray."""
    right = np.sin(bearing) - inverse * x
    back = -np.cos(bearing) - inverse * z
    return np.arctan2(right, -back) + turn, right, back, np.sqrt(max(right * right + back * back, 1e-12))


@part
def _seen_with_slopes(
    bearing: float, inverse: float, x: float, z: float, turn: float, by_motion: Array, slopes: Array
) -> tuple[float, float]:
    """Return bearing and inverse range in the second image, and write their derivatives (2, 5) by b, ρ and motion."""
    seen, right, back, distance = seen_from(bearing, inverse, x, z, turn)
    square, sin, cos = distance * distance, np.sin(bearing), np.cos(bearing)
    for row in range(2):
        # By the ray d: of the bearing, and of the inverse range ρ / |d|.
        if row == 0:
            dx, dz = -back / square, right / square
        else:
            dx, dz = -right * inverse / (square * distance), -back * inverse / (square * distance)
        slopes[row, 0], slopes[row, 1] = dx * cos + dz * sin, -(dx * x + dz * z)
        for k in range(3):
            slopes[row, 2 + k] = -inverse * (dx * by_motion[0, k] + dz * by_motion[1, k])
    slopes[0, 4] += 1.0
    slopes[1, 1] += 1.0 / distance
    return seen, inverse / distance


@part
def _wrapped(angle: float) -> float:
    return float(angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi)))


@part
def _dot(one: Array, other: Array) -> float:
    """Return the sum of products; `other` may be longer."""
    total = 0.0
    for k in range(len(one)):
        total += one[k] * other[k]
    return total


@part
def _variance(by: Array, cov: Array) -> float:
    total = 0.0
    for k in range(len(by)):
        total += by[k] * _dot(by, cov[k])
    return total


@compiled
def votes(
    images: TwoImages, moves: Array, cell: Array, turns: Array, widths: Array, kernels: Array, reaches: Indices
) -> Array:
    """Return the votes (G, B) of P pairs for B turns, evenly spaced, under each of G moves (x, z of the camera).

    kernels: (W, R) what a vote of each of W widths gives to its R next bins, of which `reaches` (W,) are not 0. cell:
    (2,) half of the distance between moves.
    """
    result = np.zeros((len(moves), len(turns)))
    for p in range(len(images.pairs)):
        one, two = images.one.measured[images.pairs[p, 0]], images.two.measured[images.pairs[p, 1]]
        inverse, spread = two[1] if np.isnan(one[1]) else one[1], 0.2 * TYPICAL_SPREAD
        if np.isnan(inverse):
            inverse, spread = TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD
        sin, cos = np.sin(one[0]), np.cos(one[0])
        by_cell = inverse * np.sqrt((cos * cell[0]) ** 2 + (sin * cell[1]) ** 2) / 2.0
        for g in range(len(moves)):
            x, z = moves[g]
            parallax = spread * (cos * x + sin * z)
            width = np.sqrt(parallax**2 + by_cell**2)
            kind = 0
            while kind < len(widths) - 1 and widths[kind] < width:
                kind += 1
            turn = _wrapped(two[0] - np.arctan2(sin - inverse * x, cos + inverse * z))
            middle = int(np.round((turn - turns[0]) / (turns[1] - turns[0])))
            for column in range(max(middle - reaches[kind] + 1, 0), min(middle + reaches[kind], len(turns))):
                result[g, column] += images.look[p] * kernels[kind, abs(column - middle)]
    return result


# -- how likely a pair is ---------------------------------------------------------------------------------------------


@part
def pair_odds(images: TwoImages, usable: NDArray[np.bool_], unknown: Array, cov: Array, on_floor: bool) -> Array:
    """Return of each pair (P, 2): odds of being one edge, and that its ends are feet.

    unknown, cov: (U,), (U, U or more) as far as they are known.
    """
    one, two, pairs = images.one, images.two, images.pairs
    turn, wrong, wrong_cov = unknown[2], unknown[3:], cov[3:, 3:]
    x, z, by_motion = camera_moved(unknown, images.mount)
    sin, cos = np.sin(turn), np.cos(turn)
    back_x, back_z = -(cos * x - sin * z), -(sin * x + cos * z)
    result, slopes = np.zeros((len(pairs), 2)), np.empty((2, 5))
    reach = _FAR_SIGMAS * (_FAR_RAD + np.sqrt(cov[2, 2]))
    moved = np.sqrt(x**2 + z**2) + _FAR_SIGMAS * np.sqrt(cov[0, 0] + cov[1, 1])
    most = TYPICAL_INVERSE_RANGE + _FAR_SIGMAS * TYPICAL_SPREAD
    for p in range(len(pairs)):
        e, f = pairs[p, 0], pairs[p, 1]
        # No edge is so near that it moves this far: most pairs end here.
        nearest = max(most, 0.0 if np.isnan(one.measured[e, 1]) else 1.5 * one.measured[e, 1])
        apart = abs(_wrapped(two.measured[f, 0] - one.measured[e, 0] - turn))
        if not usable[p] or apart > reach + nearest * moved:
            continue
        # The feet in both images, as one inverse range from the first camera, and how well they agree.
        common, foot_var, agreement = one.common[e, 1], one.sigma[e, 1] ** 2, 1.0
        foot = one.measured[e, 1] - _dot(common, wrong)
        later = two.measured[f, 1] - _dot(two.common[f, 1], wrong)
        if not np.isnan(later):
            later /= seen_from(two.measured[f, 0], later, back_x, back_z, -turn)[3]
            later_var = two.sigma[f, 1] ** 2
            if np.isnan(foot):
                foot, foot_var, common = later, later_var, two.common[f, 1]
            else:
                narrow = foot_var + later_var
                loose = narrow + TYPICAL_SPREAD**2
                agreement = np.sqrt(loose / narrow) * np.exp(-0.5 * (later - foot) ** 2 * (1.0 / narrow - 1.0 / loose))
                foot = (foot * later_var + later * foot_var) / narrow
                foot_var = foot_var * later_var / narrow
        share = 0.0
        if not np.isnan(foot):
            foot_var += (images.uneven * foot) ** 2 + _variance(common, wrong_cov)
            share = FLOOR_SHARE if on_floor else 0.0
        # Two readings of the lower end.
        total = standing = 0.0
        for reading in range(0 if share > 0.0 else 1, 2):
            inverse, variance, weight = foot, foot_var, share * agreement
            if reading == 1:
                inverse = TYPICAL_INVERSE_RANGE if np.isnan(foot) else max(TYPICAL_INVERSE_RANGE, foot)
                # What hangs keeps its height, so that its lower ends agree as well as feet do; the hidden need not.
                variance, weight = TYPICAL_SPREAD**2, (1.0 - share) * (HUNG_SHARE * agreement + 1.0 - HUNG_SHARE)
            expected, _ = _seen_with_slopes(one.measured[e, 0], inverse, x, z, turn, by_motion, slopes)
            variance = slopes[0, 1] ** 2 * variance + _variance(slopes[0, 2:], cov)
            variance += two.sigma[f, 0] ** 2 + (slopes[0, 0] * one.sigma[e, 0]) ** 2
            square = _wrapped(two.measured[f, 0] - expected) ** 2
            density = weight * np.exp(-0.5 * square / variance) / np.sqrt(variance)
            total += density
            if reading == 0:
                standing = density
        result[p, 0] = images.look[p] * total / np.sqrt(2.0 * np.pi) / images.new_density
        result[p, 1] = standing / total if total > 0.0 else 0.0
    return result


@compiled
def one_to_one(pairs: Indices, odds: Array, firsts: int, seconds: int) -> Indices:
    """Return the indices (M,) of pairs that are likelier than not, the likeliest first, each edge in one pair only."""
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
def eliminate(matrix: Array, count: int) -> None:
    """Eliminate the first unknowns of symmetric equations (U, U or more) in place, by Gauss and Jordan's steps.

    Their rows then are what they come to, given the others; the other rows are the equations without them (the Schur
    complement). Of all unknowns: the square becomes its inverse, further columns the solutions. Small, so no library.
    """
    for k in range(count):
        pivot = matrix[k, k]
        matrix[k, k] = 1.0
        for j in range(matrix.shape[1]):
            matrix[k, j] /= pivot
        for i in range(len(matrix)):
            if i == k:
                continue
            factor = matrix[i, k]
            matrix[i, k] = 0.0
            for j in range(matrix.shape[1]):
                matrix[i, j] -= factor * matrix[k, j]


@part
def _equations(
    images: TwoImages, p: int, edge: Array, moved: tuple[float, float, Array], unknown: Array, floor: float, rows: Array
) -> None:
    """Set the five equations of a pair (5, 2 + U + 1), in sigmas: by its edge, by what all share, residuals.

    Bearing and inverse range in the first image, the same in the second, and that the inverse range is a typical one.
    An equation is 0 where nothing is measured.
    """
    x, z, by_motion = moved
    rows[:] = 0.0
    rows[0, 0] = rows[1, 1] = rows[4, 1] = 1.0
    seen, inverse = _seen_with_slopes(edge[0], edge[1], x, z, unknown[2], by_motion, rows[2:4])
    expected = (edge[0], edge[1], seen, inverse)
    for r in range(4):
        image, e, column = images.one if r < 2 else images.two, images.pairs[p, r // 2], r % 2
        measured, common, variance = image.measured[e, column], image.common[e, column], image.sigma[e, column] ** 2
        weight, residual = 1.0, measured - expected[r]
        if column == 1:
            # A foot's own height is wrong in both images alike; taken as two independent errors of twice the variance.
            weight, variance = floor, variance + 2.0 * (images.uneven * measured) ** 2
        if r == 2:
            residual = _wrapped(residual)
        scale, rows[r, -1] = np.sqrt(weight / variance), residual - _dot(common, unknown[3:])
        is_known = not (np.isnan(scale) or np.isnan(residual))
        rows[r, 5 : 5 + len(common)] = common
        for k in range(rows.shape[1]):
            rows[r, k] = scale * rows[r, k] if is_known else 0.0
    rows[4, 1], rows[4, -2] = 1.0 / TYPICAL_SPREAD, -1.0 / TYPICAL_SPREAD
    rows[4, -1] = (unknown[-1] - edge[1]) / TYPICAL_SPREAD


@compiled
def solve(
    images: TwoImages, chosen: Indices, weight: Array, floor: Array, start: Array, mean: Array, information: Array
) -> tuple[Array, Array]:
    """Return the unknowns (U,) that explain the chosen pairs (M,) best, and their covariance (U, U or more).

    weight, floor: (M,) 0 … 1, of a pair, and of its ends being feet. start: (3 or more,) motion to begin at. mean,
    information: (U,), (U, U) beforehand.

    Unknown are also bearing and inverse range (b, ρ) of every edge. They appear in five equations only (bearing and
    foot in both images; ρ ~ N(μ, spread²), μ the typical one), and are eliminated one edge after the other, so that a
    handful of unknowns is left however many edges there are.
    """
    count, size = len(chosen), len(mean)
    unknown, edge = mean.copy(), np.empty((count, 2))
    unknown[:3] = start[:3]
    for m in range(count):
        one, two = images.one.measured[images.pairs[chosen[m], 0]], images.two.measured[images.pairs[chosen[m], 1]]
        foot = two[1] if np.isnan(one[1]) else one[1]
        edge[m, 0] = one[0]
        edge[m, 1] = TYPICAL_INVERSE_RANGE if np.isnan(foot) or floor[m] < 0.5 else foot
    rows, own, total = np.empty((5, size + 3)), np.empty((count, size + 2, size + 3)), np.empty((size, size + 1))
    for _ in range(_STEPS):
        total[:, size] = 0.0
        total[:, :size] = information
        for i in range(size):
            for j in range(size):
                total[i, size] += information[i, j] * (mean[j] - unknown[j])
        moved = camera_moved(unknown, images.mount)
        for m in range(count):
            _equations(images, chosen[m], edge[m], moved, unknown, floor[m], rows)
            own[m] = 0.0
            for i in range(size + 2):
                for r in range(5):
                    scaled = weight[m] * rows[r, i]
                    if scaled != 0.0:
                        for j in range(size + 3):
                            own[m, i, j] += scaled * rows[r, j]
            eliminate(own[m], 2)
            total += own[m, 2:, 2:]
        eliminate(total, size)
        step = total[:, size]
        unknown += step
        for m in range(count):
            for a in range(2):
                edge[m, a] += own[m, a, size + 2] - _dot(own[m, a, 2:-1], step)
        if np.abs(step).max() < _SMALL_STEP:
            break
    return unknown, total


# -- pairing and solving in turns -------------------------------------------------------------------------------------


@compiled
def refine(
    images: TwoImages, usable: NDArray[np.bool_], prior: Array, information: Array, on_floor: bool, start: Array
) -> tuple[Array, Array, Indices, Array]:
    """Return what pairing edges and solving in turns leads to, from a motion `start` (3,).

    Motion (3,), its covariance (3, 3), indices of the pairs chosen (M,), and their log-likelihoods (M,). usable: (P,)
    whether a pair is. prior, information: mean (3,) and inverse covariance (3, 3) of it. on_floor: whether lower ends
    may be feet.
    """
    size = 4 + images.one.common.shape[2]
    mean, whole, unknown, cov = np.zeros(size), np.eye(size), np.zeros(size), np.eye(size)
    mean[:3], whole[:3, :3], unknown[:3] = prior, information, start
    mean[-1], whole[-1, -1] = TYPICAL_INVERSE_RANGE, TYPICAL_INFORMATION
    for k in range(3):
        cov[k, k] = START_SIGMA[k] ** 2
    chosen, log_likelihood = np.empty(0, dtype=np.int64), np.empty(0)
    for _ in range(_ROUNDS):
        odds = pair_odds(images, usable, unknown, cov, on_floor)
        firsts, seconds = len(images.one.measured), len(images.two.measured)
        previous, chosen = chosen, one_to_one(images.pairs, odds[:, 0], firsts, seconds)
        count, before = len(chosen), unknown
        if count == 0:
            break
        settled = len(previous) == count
        weight, floor, log_likelihood = np.empty(count), np.empty(count), np.empty(count)
        for m in range(count):
            p = chosen[m]
            log_likelihood[m], floor[m] = np.log1p(odds[p, 0]), odds[p, 1]
            weight[m] = odds[p, 0] / (1.0 + odds[p, 0])
            settled = settled and previous[m] == p
        unknown, cov = solve(images, chosen, weight, floor, before, mean, whole)
        for k in range(3):
            settled = settled and abs(unknown[k] - before[k]) < 0.1 * np.sqrt(cov[k, k])
        if settled:
            break
    return unknown[:3], cov[:3, :3], chosen, log_likelihood
