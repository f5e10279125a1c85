"""Two frames → the motion between them: search, then alternate between pairing edges and solving for the motion.

Edges of one thing share their fate: all edges of a poster end above the floor, and a moving chair moves them all. A
covariance that takes them as independent is far too small. So the motion is found again without the edges of each
group in turn, and what these results differ by is added (the delete-a-group jackknife [Efron, Tibshirani 1993,
chapter 11]): where all hangs on one group, the covariance says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.increments.fuse import mixture
from localiser.increments.pairs import Pairs, candidates, likelihoods, one_to_one
from localiser.increments.search import likely_motions
from localiser.increments.solve import Gaussian, Links, solve
from localiser.increments.views import Sights, camera_motion

_PEAKS = 4
_HANGING_SHARE = 0.1
"""Of views in which no lower end is a foot: a wall close by and what hangs on it. All such edges seem far, their ends
near the horizon, and agree on a wrong motion, each as surely as a foot; taken one by one they would win."""
_ROUNDS = 10
_APART_RAD = np.deg2rad(3.0)
"""Edges closer together than this are likely of one thing: a door, a poster, a shelf."""
_START_SIGMA = np.array([2e-3, 2e-3, 5e-4])
"""How far a start of the search may be off: right, backward (m), turn (rad)."""


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """How the robot moved, by the edges of two frames.

    mean: (3,) right (m), backward (m), turn (rad) in the robot frame of the first. cov: (3, 3).
    first, second: (M,) indices of the edges that were followed. weight: (M,) how surely they are the same, 0 … 1.
    on_floor: (M,) how surely their lower end is where they meet the floor.
    log_likelihood: of the pairs. log_occam: how much of the prior the motion found takes up.
    """

    mean: Array
    cov: Array
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    weight: Array
    on_floor: Array
    log_likelihood: float
    log_occam: float

    @property
    def log_evidence(self) -> float:
        """Logarithm of how well the frames are explained, by Laplace's approximation."""
        return self.log_likelihood + self.log_occam


def follow(
    before: Edges,
    after: Edges,
    camera: Camera,
    prior: Gaussian,
    starts: Sequence[Array] = (),
    feet: bool = True,
) -> Followed:
    """Return the motion between two frames, given what is believed of it beforehand.

    starts: motions (3,) to begin at; when none are given, all that the prior allows is searched.
    feet: whether the ranges of feet tell how far the robot moved; they always help to tell edges apart.
    """
    sights = (Sights.of(before, camera), Sights.of(after, camera))
    pairs = candidates(before, after)
    if len(pairs.first) == 0:
        return _nothing(prior)
    starts = starts or likely_motions(pairs, sights, camera, prior.cov, _PEAKS)
    found = [_nothing(prior), *(_refined(pairs, sights, camera, prior, motion, feet) for motion in starts)]
    found.sort(key=lambda followed: -followed.log_evidence)
    best = found[0]
    hanging = _refined(pairs, sights, camera, prior, best.mean, feet, on_floor=False)
    found.append(replace(hanging, log_occam=hanging.log_occam + np.log(_HANGING_SHARE)))
    group = groups(before.bearing[best.first])
    # Edges of one group are one piece of evidence, not many.
    share = (group.max(initial=0) + 1) / max(len(group), 1)
    whole = mixture(
        [Gaussian(other.mean, other.cov) for other in found],
        np.array([share * other.log_likelihood + other.log_occam for other in found]),
    )
    spread = whole.cov + np.outer(whole.mean - best.mean, whole.mean - best.mean)
    # What the best is certain of, and by how much it may be another.
    cov = spread + _fragility(best, group, pairs, sights, camera, prior, feet)
    return replace(best, cov=cov, log_likelihood=share * best.log_likelihood)


def groups(bearing: Array) -> NDArray[np.int64]:
    """Return the group (M,) of each edge: those less than a few degrees from the next, as the sides of one thing."""
    order = np.argsort(bearing)
    group = np.empty(len(bearing), dtype=np.int64)
    group[order] = np.cumsum(np.diff(bearing[order], prepend=-np.inf) > _APART_RAD) - 1
    return group


def _fragility(
    followed: Followed,
    group: NDArray[np.int64],
    pairs: Pairs,
    sights: tuple[Sights, Sights],
    camera: Camera,
    prior: Gaussian,
    feet: bool,
) -> Array:
    """Return the covariance (3, 3) of what the motion changes by when one group (M,) of edges is left out."""
    count = int(group.max(initial=-1)) + 1
    change = np.zeros((count, 3))
    for left_out in range(count):
        kept = pairs.of(followed.first[group != left_out], followed.second[group != left_out])
        change[left_out] = _refined(kept, sights, camera, prior, followed.mean, feet).mean - followed.mean
    return np.asarray(change.T @ change) * max(count - 1, 1) / max(count, 1)


def _refined(
    pairs: Pairs,
    sights: tuple[Sights, Sights],
    camera: Camera,
    prior: Gaussian,
    start: Array,
    feet: bool,
    on_floor: bool = True,
) -> Followed:
    """Return the motion found by pairing edges and solving for the motion in turns, from `start` (3,)."""
    motion, cov = start, np.diag(_START_SIGMA**2)
    chosen = np.zeros(0, dtype=np.int64)
    for _ in range(_ROUNDS):
        moved, by_robot = camera_motion(motion, camera)
        likely = likelihoods(pairs, sights, moved, by_robot @ cov @ by_robot.T, _span(camera), on_floor)
        previous, chosen = chosen, one_to_one(pairs, likely.ratio)
        if len(chosen) == 0:
            return _nothing(prior)
        ratio = likely.ratio[chosen]
        links = Links(
            (sights[0].take(pairs.first[chosen]), sights[1].take(pairs.second[chosen])),
            likely.sharp[chosen] * ratio / (1.0 + ratio),
            likely.on_floor[chosen],
            feet,
        )
        before, solution = motion, solve(links, camera, motion, prior)
        motion, cov = solution.motion, solution.cov
        if np.array_equal(previous, chosen) and (np.abs(motion - before) < 0.1 * np.sqrt(np.diag(cov))).all():
            break
    occam = prior.log_density(motion) + 0.5 * float(np.linalg.slogdet(2 * np.pi * cov)[1])
    likelihood = float(np.log1p(ratio).sum())
    return Followed(
        motion,
        cov,
        pairs.first[chosen],
        pairs.second[chosen],
        links.weight,
        links.on_floor,
        likelihood,
        occam,
    )


def _nothing(prior: Gaussian) -> Followed:
    none = np.zeros(0, dtype=np.int64)
    return Followed(prior.mean, prior.cov, none, none, np.zeros(0), np.zeros(0), 0.0, 0.0)


def _span(camera: Camera) -> float:
    """Return the horizontal field of view (rad) along the horizon."""
    a_left, a_right, _, _ = camera.upright_bounds
    left, right = np.arctan(np.array([a_left, a_right]) / np.cos(camera.mount.tilt_rad))
    return float(right - left)
