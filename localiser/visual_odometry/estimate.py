"""The motion between two images: find starts by votes, then pair edges and solve for the motion alternately.

The errors of edges of one thing are not independent: all edges of a poster end above the floor, and a moving chair
moves all of its edges. A covariance that treats them as independent is far too small. So the motion is estimated again
without the edges of each group in turn. The covariance is at least the scatter of these results (the delete-a-group
jackknife [Efron, Tibshirani 1993, chapter 11]). It is large where everything depends on one group.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, wrap_angle
from localiser.particles import normalised
from localiser.visual_odometry.two_images import TwoImages

_REACH = 2.5  # sigmas of the prior that are searched
_BIN_RAD, _MOST_BINS = np.deg2rad(0.25), 1440
_WIDTHS_RAD = np.deg2rad([0.3, 0.6, 1.2, 2.4, 4.8])
_GRID = np.linspace(-1.0, 1.0, 7)
_KERNEL_REACH = 3.0  # sigmas
_PEAKS = 4
# Of views in which no lower end is a foot: a wall close by and what hangs on it. All such edges seem far, their ends
# near the horizon, and agree on a wrong motion, each as surely as a foot; taken one by one they would win.
_HANGING_SHARE = 0.3


# -- motions, normally distributed ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Gaussian:
    """What is believed of a motion: mean (3,), right (m), backward (m), turn (rad), and covariance (3, 3)."""

    mean: Array
    cov: Array

    def log_density(self, value: Array) -> float:
        """Return log N(value (3,); mean, cov)."""
        apart = value - self.mean
        return float(-0.5 * (apart @ np.linalg.solve(self.cov, apart) + np.linalg.slogdet(2 * np.pi * self.cov)[1]))


def mixture(parts: Sequence[Gaussian], weight: Array) -> Gaussian:
    """Return the Gaussian with mean and covariance of a mixture of K motions; weight: (K,) of sum 1."""
    origin = parts[int(weight.argmax())].mean
    offset = np.array([part.mean - origin for part in parts])
    offset[:, 2] = wrap_angle(offset[:, 2])
    mean = weight @ offset
    spread = offset - mean
    within = np.einsum("k,kij->ij", weight, [part.cov for part in parts])
    total = origin + mean
    total[2] = wrap_angle(total[2])
    return Gaussian(total, within + np.einsum("k,ki,kj->ij", weight, spread, spread))


def at_least(cov: Array, other: Array) -> Array:
    """Return the smallest covariance (3, 3) that is in no direction below either: both estimate the same spread."""
    root = np.linalg.cholesky(cov)
    inverse = np.linalg.inv(root)
    ratio, axes = np.linalg.eigh(inverse @ other @ inverse.T)
    grown = root @ axes * np.sqrt(np.maximum(ratio, 1.0))
    return np.asarray(grown @ grown.T)


# -- starts -----------------------------------------------------------------------------------------------------------


def likely_motions(images: TwoImages, prior: Gaussian) -> list[Array]:
    """Return up to `_PEAKS` motions (3,) that most pairs agree on, of turns apart from one another, best first.

    A Hough transform: for a coarse grid of translations, among those that the prior allows, each pair votes for its
    change of bearing minus the parallax, blurred by the uncertainty of its range and of the grid.
    """
    from localiser.visual_odometry import twist_kernel as kernel

    sigma = np.sqrt(np.diag(prior.cov))
    reach = min(_REACH * sigma[2], np.pi)
    bins = int(np.clip(2 * reach / _BIN_RAD, 3, _MOST_BINS)) | 1
    turns = prior.mean[2] + np.linspace(-reach, reach, bins)
    offset = np.stack(np.meshgrid(_GRID, _GRID), axis=-1).reshape(-1, 2) * _REACH * 0.8
    grid = prior.mean[:2] + offset * sigma[:2]
    cell = (_GRID[1] - _GRID[0]) * _REACH * 0.8 * sigma[:2] / 2
    moves = np.array([kernel.camera_moved(np.array([*step, 0.0]), images.mount)[:2] for step in grid])
    # What a vote of each width gives to the bins at 0, 1, 2 … from it; 0 beyond its reach.
    bin_rad = turns[1] - turns[0]
    width = np.maximum(_WIDTHS_RAD, bin_rad)[:, None]
    apart = np.arange(int(_KERNEL_REACH * width.max() / bin_rad) + 1) * bin_rad / width
    kernels = np.where(apart < _KERNEL_REACH, np.exp(-0.5 * apart**2) / width, 0.0)
    found = kernel.votes(images, moves, cell, turns, _WIDTHS_RAD, kernels, (kernels > 0).sum(axis=1))
    found = found * np.exp(-0.5 * (offset**2).sum(axis=-1)[:, None] / 4)

    best, likely = found.max(axis=0), list[Array]()
    while len(likely) < _PEAKS and best.max() > 0:
        column = int(best.argmax())
        likely.append(np.array([*grid[int(found[:, column].argmax())], turns[column]]))
        best = np.where(np.abs(turns - turns[column]) < 4 * _WIDTHS_RAD[0], 0.0, best)
    return likely


# -- the motion -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """How the robot moved, by the edges of two images.

    motion: in the robot frame of the first.
    chosen: (M,) indices of the pairs of edges that were followed.
    log_evidence: of how well the images are explained, by Laplace's approximation.
    has_feet: whether any lower end was taken for a foot.
    """

    motion: Gaussian
    chosen: NDArray[np.int64]
    log_evidence: float
    has_feet: bool = True


def follow(images: TwoImages, starts: Sequence[Array], priors: Sequence[tuple[Gaussian, float]]) -> Followed:
    """Return the motion between two images.

    starts: motions (3,) to begin at, the best first. priors: what may be believed of it, and the logarithm of how often
    that is right. Each explains the edges more or less well, and Bayes' rule weighs them by that. Where
    contradicting motions explain them alike, the covariance reaches from the one to the other [Bar-Shalom, Li,
    Kirubarajan 2001, section 1.4.16]: contradictions are never averaged into something certain, and the map decides.
    """
    found: list[tuple[Followed, Followed]] = []
    every = np.ones(len(images.pairs), dtype=np.bool_)
    for prior, log_share in priors:
        nothing = Followed(prior, np.zeros(0, dtype=np.int64), log_share)
        tried = [nothing]
        if len(images.pairs) and len(starts):
            standing = _distinct(_refined(images, nothing, start, True, every) for start in starts)
            again = standing[0].motion.mean, starts[0]
            tried += standing + _distinct(_refined(images, nothing, start, False, every) for start in again)
        found += [(nothing, each) for each in tried]
    nothing, best = max(found, key=lambda pair: pair[1].log_evidence)
    weight = normalised(np.array([each.log_evidence for _, each in found]))
    whole = mixture([each.motion for _, each in found], weight)
    # What the motion changes by when one group of edges is left out.
    group = np.full(len(images.pairs), -1)
    group[best.chosen] = images.groups(best.chosen)
    count = int(group.max(initial=-1)) + 1
    change = np.zeros((count, 3))
    for left_out in range(count):
        usable = (group >= 0) & (group != left_out)
        left = _refined(images, nothing, best.motion.mean, best.has_feet, usable)
        change[left_out] = left.motion.mean - best.motion.mean
    fragility = change.T @ change * max(count - 1, 1) / max(count, 1)
    return replace(best, motion=Gaussian(whole.mean, at_least(whole.cov, fragility)))


def _refined(images: TwoImages, nothing: Followed, start: Array, on_floor: bool, usable: NDArray[np.bool_]) -> Followed:
    """Return the motion found from the motion `start` (3,).

    nothing: what is believed where no edge is followed; its motion is the prior. on_floor: whether lower ends may be
    feet at all. usable: (P,) whether a pair is.
    """
    from localiser.visual_odometry import twist_kernel as kernel

    prior = nothing.motion
    information: Array = np.asarray(np.linalg.inv(prior.cov))
    mean, cov, chosen, log_likelihood = kernel.refine(images, usable, prior.mean, information, on_floor, start)
    if len(chosen) == 0:
        return nothing
    group = images.groups(chosen)
    occam = prior.log_density(mean) + 0.5 * float(np.linalg.slogdet(2 * np.pi * cov)[1])
    share = nothing.log_evidence + float(np.log(1.0 - _HANGING_SHARE if on_floor else _HANGING_SHARE))
    # Edges of one group are one piece of evidence, not many.
    evidence = float((log_likelihood / np.bincount(group)[group]).sum()) + occam + share
    return Followed(Gaussian(mean, cov), chosen, evidence, on_floor)


def _distinct(followed: Iterable[Followed]) -> list[Followed]:
    """Return those that are not the same motion found once more, from another start; the best first."""
    kept: list[Followed] = []
    for new in sorted(followed, key=lambda new: -new.log_evidence):
        sigma = np.sqrt(np.diag(new.motion.cov))
        if all((np.abs(new.motion.mean - old.motion.mean) > 0.5 * sigma).any() for old in kept):
            kept.append(new)
    return kept
