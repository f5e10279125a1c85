"""Which edge of one frame is which of the next: candidates, and how likely each is under a motion.

An edge of the second frame continues one of the n edges of the first with probability w, each as likely as the other,
else it is new. Polarities must agree; grey values on at least one side do, since what stands behind the other side
changes. Given a motion the bearing is predicted, for two readings of the edge's lower end:

- it is the foot, where the edge meets the floor, and tells the range, or
- it is not (a window, a skirting board, something in front), and the edge is at any range nearer than that.

And the bearing itself may be one of a neighbour a few pixels beside it, of which each frame shows another: such a pair
is no new edge, and tells nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser import geometry
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.increments.views import Sights, predicted

FOLLOWED_SHARE = 0.7  # of the edges of an image, seen in the one before
FLOOR_SHARE = 0.5  # of the lower ends that are feet
HUNG_SHARE = 0.5  # of the others, that hang at a height of their own; the rest is hidden by something in front
TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD = 0.4, 0.3  # 1/m: rooms are some metres wide, and edges stand all over them
NEIGHBOUR_SHARE = 0.15  # of pairs whose bearings are of two edges beside each other
NEIGHBOUR_SIGMA_RAD = np.deg2rad(0.3)  # how far apart
LOOK_SIGMA = 12.0  # grey levels that an unchanged side of an edge differs by
LOOK_FLOOR = 0.1  # likelihood of an edge whose both sides changed, beside one that did not


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """P pairs that may be one edge: first, second (P,) indices of edges. look: (P,) how alike, 0 … 1."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    look: Array

    def of(self, first: NDArray[np.int64], second: NDArray[np.int64]) -> Pairs:
        """Return those of the pairs that link `first` (M,) with `second` (M,)."""
        wanted = set(zip(first.tolist(), second.tolist(), strict=True))
        kept = [pair in wanted for pair in zip(self.first.tolist(), self.second.tolist(), strict=True)]
        return Pairs(self.first[kept], self.second[kept], self.look[kept])


def candidates(before: Edges, after: Edges) -> Pairs:
    """Return all pairs of edges whose polarities do not contradict each other."""
    product = before.polarity[:, None].astype(int) * after.polarity
    first, second = np.nonzero(product >= 0)
    return Pairs(first, second, _look(before.profile, after.profile)[first, second])


def _look(before: Array, after: Array) -> Array:
    """Return how alike (E, F) profiles (E, P) and (F, P) are: the side that changed less decides; 1 where unknown."""
    if before.shape[1] == 0 or before.shape[1] != after.shape[1]:
        return np.ones((len(before), len(after)))
    square = (before[:, None] - after) ** 2
    half = square.shape[-1] // 2
    nearer = np.minimum(square[..., :half].mean(axis=-1), square[..., -half:].mean(axis=-1))
    return np.asarray(np.maximum(np.nan_to_num(np.exp(-0.5 * nearer / LOOK_SIGMA**2), nan=1.0), LOOK_FLOOR))


@dataclass(frozen=True, slots=True, eq=False)
class Likelihoods:
    """How likely pairs (P,) are under a motion.

    ratio: odds of being one edge against being new. sharp: that its bearings are right. on_floor: that its lower ends
    are feet.
    """

    ratio: Array
    sharp: Array
    on_floor: Array


def likelihoods(
    pairs: Pairs, sights: tuple[Sights, Sights], moved: Array, moved_cov: Array, span_rad: float, on_floor: bool = True
) -> Likelihoods:
    """Return how likely each pair is when the camera moved by `moved` (3,), known up to `moved_cov` (3, 3).

    on_floor: whether lower ends may be feet at all.
    """
    one = sights[0]
    foot, foot_var, agreement = _feet(pairs, sights, moved)
    has_foot = np.isfinite(foot)
    nearer = np.maximum(TYPICAL_INVERSE_RANGE, np.where(has_foot, foot, 0.0))
    floor = _density(pairs, sights, moved, moved_cov, np.where(has_foot, foot, 0.0), foot_var)
    free = _density(pairs, sights, moved, moved_cov, nearer, np.full(len(nearer), TYPICAL_SPREAD**2))
    share = np.where(has_foot & on_floor, np.interp(foot, *_FLOOR_SHARES), 0.0)
    floor = floor * (share * agreement)[:, None]
    # What hangs keeps its height, so that its lower ends agree as well as feet do; what is hidden need not.
    free = free * ((1.0 - share) * (HUNG_SHARE * agreement + 1.0 - HUNG_SHARE))[:, None]
    density = (floor + free) * [1.0 - NEIGHBOUR_SHARE, NEIGHBOUR_SHARE]
    total = np.maximum(density.sum(axis=1), 1e-300)
    odds = FOLLOWED_SHARE / (1.0 - FOLLOWED_SHARE) / max(len(one.bearing), 1)
    return Likelihoods(
        odds * span_rad * pairs.look * total,
        density[:, 0] / total,
        floor[:, 0] / np.maximum(floor[:, 0] + free[:, 0], 1e-300),
    )


def _floor_shares() -> tuple[Array, Array]:
    """Return a table of inverse ranges ρ (1/m), and how likely a lower end that would be a foot there is one.

    With p(ρ) what is typical, a foot is there with p(ρ), and an end at any height up to the camera's, which looks
    farther than it is, with ∫ p(r)/r dr from ρ on: near the horizon hardly anything stands on the floor.
    """
    inverse = np.geomspace(1e-3, TYPICAL_INVERSE_RANGE + 6.0 * TYPICAL_SPREAD, 200)
    feet = np.exp(-0.5 * ((inverse - TYPICAL_INVERSE_RANGE) / TYPICAL_SPREAD) ** 2)
    steps = 0.5 * (feet[1:] + feet[:-1]) * np.diff(np.log(inverse))  # dr/r = d log r
    hanging = np.append(np.cumsum(steps[::-1])[::-1], 0.0)
    return inverse, FLOOR_SHARE * feet / (FLOOR_SHARE * feet + (1.0 - FLOOR_SHARE) * hanging)


_FLOOR_SHARES = _floor_shares()


def _feet(pairs: Pairs, sights: tuple[Sights, Sights], moved: Array) -> tuple[Array, Array, Array]:
    """Return inverse range (P,) from the first camera by the feet in both frames, its variance, and their agreement."""
    one, two = sights
    back = predicted(two.bearing, np.nan_to_num(two.inverse_range), geometry.between(moved, np.zeros(3)))
    seen_later = np.where(np.isnan(two.inverse_range), np.nan, back.inverse_range)
    values = np.stack([one.inverse_range[pairs.first], seen_later[pairs.second]])
    variances = np.stack([one.sigma[pairs.first, 1], two.sigma[pairs.second, 1]]) ** 2
    known = np.isfinite(values)
    weight = np.where(known, 1.0 / np.where(known, variances, 1.0), 0.0)
    total = np.maximum(weight.sum(axis=0), 1e-12)
    mean = np.where(known.any(axis=0), (weight * np.where(known, values, 0.0)).sum(axis=0) / total, np.nan)
    common = np.where(known[0], _common_var(one)[pairs.first], _common_var(two)[pairs.second])
    twice = known.all(axis=0)
    agreement = _agreement(np.where(twice, values[1] - values[0], 0.0), np.where(twice, variances.sum(axis=0), 1.0))
    return mean, 1.0 / total + common, np.where(twice, agreement, 1.0)


def _common_var(sights: Sights) -> Array:
    """Return the variance (E,) that common errors give to the inverse range of a foot."""
    return np.asarray(np.square(sights.common[:, 1]).sum(axis=-1))


def _agreement(apart: Array, variance: Array) -> Array:
    """Return how much likelier two inverse ranges are to differ so if both are right than if one is anything."""
    loose = variance + TYPICAL_SPREAD**2
    return np.asarray(np.sqrt(loose / variance) * np.exp(-0.5 * apart**2 * (1.0 / variance - 1.0 / loose)))


def _density(
    pairs: Pairs, sights: tuple[Sights, Sights], moved: Array, moved_cov: Array, inverse: Array, inverse_var: Array
) -> Array:
    """Return the density (P, 2) of the second bearing, given the first and an inverse range; right, and a neighbour."""
    one, two = sights
    seen = predicted(one.bearing[pairs.first], inverse, moved)
    by_motion = seen.by_motion[:, 0]
    variance = (
        two.sigma[pairs.second, 0] ** 2
        + (seen.by_edge[:, 0, 0] * one.sigma[pairs.first, 0]) ** 2
        + seen.by_edge[:, 0, 1] ** 2 * inverse_var
        + np.einsum("pi,ij,pj->p", by_motion, moved_cov, by_motion)
    )
    variance = np.stack([variance, variance + NEIGHBOUR_SIGMA_RAD**2], axis=-1)
    residual = geometry.wrap_angle(two.bearing[pairs.second] - seen.bearing)[:, None]
    return np.asarray(np.exp(-0.5 * residual**2 / variance) / np.sqrt(2 * np.pi * variance))


def one_to_one(pairs: Pairs, ratio: Array) -> NDArray[np.int64]:
    """Return the indices of pairs that are likelier than not, the likeliest first, each edge in one pair only."""
    taken: tuple[set[int], set[int]] = (set(), set())
    chosen = []
    for index in np.argsort(-ratio, kind="stable"):
        if ratio[index] <= 1.0:
            break
        first, second = int(pairs.first[index]), int(pairs.second[index])
        if first in taken[0] or second in taken[1]:
            continue
        taken[0].add(first)
        taken[1].add(second)
        chosen.append(int(index))
    return np.array(chosen, dtype=np.int64)
