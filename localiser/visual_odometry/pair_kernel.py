"""The loop over pairs of edges, compiled by numba: imported only once edges are followed (docs/visual_odometry.md).

The range is inverse (ρ), because the foot of an edge is seen at a depression whose tangent is h ρ, so that its error is
one of ρ; and because ρ = 0 is a far edge like any other, which shows the turn and nothing else.
"""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array
from localiser.geometry.compiled import compiled, part
from localiser.visual_odometry.two_images import TYPICAL_SPREAD, TwoImages

FLOOR_SHARE = 0.5  # of the lower ends that are feet
HUNG_SHARE = 0.5  # of lower ends that are no feet, that hang at a height of their own; something hides the rest
WALL_SPREAD = 0.05  # 1/m, of what hangs on one wall
_SPREAD_VAR = TYPICAL_SPREAD**2
_FAR_SIGMAS = 5.0  # beyond which a pair is none


@compiled
def seen_from(bearing: float, inverse: float, move: Array) -> tuple[float, float, float]:
    """Return how a camera that made a move (3,) sees an edge: bearing, |d| of its ray, and ∂bearing/∂ρ."""
    right = np.sin(bearing) - inverse * move[0]
    back = -np.cos(bearing) - inverse * move[1]
    square = max(right * right + back * back, 1e-12)
    return np.arctan2(right, -back) + move[2], np.sqrt(square), (back * move[0] - right * move[1]) / square


@part
def _apart(bearing: float, other: float) -> float:
    """Return the difference of two angles less than 3 π apart, -π … π."""
    apart = bearing - other
    if apart > np.pi:
        return apart - 2.0 * np.pi
    return apart + 2.0 * np.pi if apart < -np.pi else apart


@part
def _normal(miss: float, variance: float) -> float:
    return float(np.exp(-0.5 * miss * miss / variance) / np.sqrt(2.0 * np.pi * variance))


@compiled
def log_likelihoods(images: TwoImages, moves: Array, typical: Array, on_wall: bool) -> Array:
    """Return log p(second image | first, motion) (N,) of camera motions (N, 3), over that of an image of new edges.

    typical: (N,) inverse range. on_wall: whether all edges are on a wall at that range, and no lower end is a foot.
    Else the lower ends of a pair are feet, or the edge is nearer, at about the typical range.
    """
    one, two, pairs = images.one, images.two, images.pairs
    result = np.zeros(len(moves))
    odds = np.empty(len(two.measured))
    spread_var = WALL_SPREAD**2 if on_wall else _SPREAD_VAR
    # Of each edge as foot, and as one that hangs: bearing, |d|, slope.
    expected = np.empty((len(one.measured), 2, 3))
    for n in range(len(moves)):
        for e in range(len(one.measured)):
            foot = one.measured[e, 1]
            for reading in range(2):
                inverse = typical[n]
                if not np.isnan(foot):
                    inverse = foot if reading == 0 else max(inverse, foot)
                seen, distance, slope = seen_from(one.measured[e, 0], inverse, moves[n])
                expected[e, reading, 0], expected[e, reading, 1], expected[e, reading, 2] = seen, distance, slope
        odds[:] = 0.0
        for p in range(len(pairs)):
            e, f = pairs[p, 0], pairs[p, 1]
            base = one.variance[e, 0] + two.variance[f, 0]
            miss = _apart(two.measured[f, 0], expected[e, 1, 0])
            variance = base + expected[e, 1, 2] ** 2 * spread_var
            if miss * miss > _FAR_SIGMAS**2 * variance:  # most pairs
                continue
            foot, foot_var, agreement = one.measured[e, 1], one.variance[e, 1], 1.0
            later, later_var = two.measured[f, 1] * expected[e, 0, 1], two.variance[f, 1] * expected[e, 0, 1] ** 2
            if not np.isnan(foot) and not np.isnan(later):
                narrow = foot_var + later_var
                loose = narrow + _SPREAD_VAR
                agreement = np.sqrt(loose / narrow) * np.exp(-0.5 * (later - foot) ** 2 * (1.0 / narrow - 1.0 / loose))
                foot = (foot * later_var + later * foot_var) / narrow
                foot_var *= later_var / narrow
            # What hangs keeps its height, so that its lower ends agree as well as feet do; the hidden need not.
            either = (HUNG_SHARE * agreement + 1.0 - HUNG_SHARE) * _normal(miss, variance)
            if not (on_wall or np.isnan(foot)):
                slope = expected[e, 0, 2]
                miss = _apart(two.measured[f, 0], expected[e, 0, 0]) - slope * (foot - one.measured[e, 1])
                stands = _normal(miss, base + slope**2 * (foot_var + one.common[e, 1]))
                either = FLOOR_SHARE * agreement * stands + (1.0 - FLOOR_SHARE) * either
            odds[f] += images.look[p] * either
        for f in range(len(odds)):
            result[n] += images.weight[f] * np.log1p(odds[f])
    return result
