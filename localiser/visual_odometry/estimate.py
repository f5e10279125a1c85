"""The motion between two images: weighted samples, drawn again and again from where the last ones were likely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from localiser.geometry import Array, between, compose, wrap_angle
from localiser.particles import POSE, Particles, largest_step, log_sum, normalised
from localiser.visual_odometry.two_images import TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD, TwoImages

_COUNT = 128
# Standard normal, (_COUNT, 4), evenly spread (the lattice R4 [Roberts 2018]): nothing is random.
_LATTICE = (np.arange(_COUNT)[:, None] * 1.1673039782614187 ** -np.arange(1.0, 5.0) + 0.5) % 1.0
_DRAWS: Array = np.vectorize(NormalDist().inv_cdf)(_LATTICE)
_FEWEST = 0.1 * _COUNT  # effective samples of each round
_GROWN = 1.2  # by which the next round's covariance is larger than what was found
_MOST_ROUNDS = 15
# Of views in which no lower end is a foot: a wall close by and what hangs on it. All such edges seem far, their ends
# near the horizon, and agree on a wrong motion, each as surely as a foot; taken one by one they would win.
_WALL_SHARE = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Gaussian:
    """What is believed of a motion: mean (3,), right (m), backward (m), turn (rad), and covariance (3, 3).

    Or (4,) and (4, 4), with the typical inverse range (1/m).
    """

    mean: Array
    cov: Array

    def log_density(self, value: Array) -> Array:
        """Return log N(value (..., 3); mean, cov) (...)."""
        apart = value - self.mean
        square = (apart @ np.linalg.inv(self.cov) * apart).sum(axis=-1)
        return np.asarray(-0.5 * (square + np.linalg.slogdet(2 * np.pi * self.cov)[1]))


def mixture(parts: Sequence[Gaussian], weight: Array) -> Gaussian:
    """Return the Gaussian with mean and covariance of a mixture of K motions; weight: (K,) of sum 1."""
    origin = parts[int(weight.argmax())].mean
    offset = np.array([part.mean - origin for part in parts])
    offset[:, 2] = wrap_angle(offset[:, 2])
    mean = weight @ offset
    total, spread = origin + mean, offset - mean
    total[2] = wrap_angle(total[2])
    within = np.einsum("k,kij->ij", weight, [part.cov for part in parts])
    return Gaussian(total, within + np.einsum("k,ki,kj->ij", weight, spread, spread))


def follow(images: TwoImages, priors: Sequence[tuple[Gaussian, float]]) -> Gaussian:
    """Return the motion between two images, by population Monte Carlo [Cappé et al. 2004].

    priors: what may be believed of it, and the logarithm of how often that is right; the widest last. After 15 rounds
    the result is wider than what edges tell.
    """
    if not len(images.pairs):
        return mixture([prior for prior, _ in priors], normalised(np.array([log_share for _, log_share in priors])))
    from localiser.visual_odometry import pair_kernel

    known = []  # with the typical inverse range as a fourth dimension
    for prior, log_share in priors:
        cov = np.diag([0.0, 0.0, 0.0, TYPICAL_SPREAD**2])
        cov[:3, :3] = prior.cov
        known.append((Gaussian(np.append(prior.mean, TYPICAL_INVERSE_RANGE), cov), log_share))
    (first, second), cases, log_means = images.mounts, [], []
    for on_wall in (False, True):
        motion = known[-1][0]
        for _ in range(_MOST_ROUNDS):
            drawn = motion.mean + _DRAWS @ np.linalg.cholesky(motion.cov).T
            moves = between(first[None], compose(drawn[:, :3], second))
            log_fit = pair_kernel.log_likelihoods(images, moves, drawn[:, 3].copy(), on_wall)
            log_prior = np.logaddexp.reduce([each.log_density(drawn) + log_share for each, log_share in known])
            log_ratio = log_prior - motion.log_density(drawn) + log_fit
            taken = largest_step(np.zeros(_COUNT), log_ratio, 1.0, _FEWEST)
            found = Particles((*POSE, "range"), drawn.T.copy(), taken * log_ratio).estimate
            mean = found.mean.copy()  # beside the last one, so that a turn near ±π is compared with its prior
            mean[2] = motion.mean[2] + wrap_angle(mean[2] - motion.mean[2])
            motion = Gaussian(mean, (1.0 if taken == 1.0 else _GROWN) * found.cov)
            if taken == 1.0:
                break
        cases.append(motion)
        log_means.append(log_sum(log_ratio) - float(np.log(_COUNT)))
    whole = mixture(cases, normalised(np.log([1.0 - _WALL_SHARE, _WALL_SHARE]) + np.array(log_means)))
    return Gaussian(whole.mean[:3], whole.cov[:3, :3])
