"""The probability that the robot is lost, that is, that it is not where any of the particles are.

Normalised weights cannot show this: of particles that are all wrong some are always the best. The likelihood itself
can. It is relative to the case that all edges are clutter, which they are for a robot that is elsewhere. So each image
divides the odds of being lost by p(edges | particles). At a right pose this is far more than 1, however many edges are
clutter. In an image in which no landmark is found it is a little less than 1; `inliers` has learnt how often such
images occur. An image that is only partly new counts for that part. Before each image there is a small probability
that the robot was carried away.

A wrong place may look like the right one, as the other end of a corridor does. Then it means nothing that its particles
fit. What counts is whether the right place would have been found if it were another one. So the robot stays lost with
the probability that every image has `overlooked` its place.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from localiser.geometry import Array
from localiser.observation import INLIER_RATES, InlierRate
from localiser.particles import log_sum, normalised

SOME = 0.3  # of the edges: from here on they are not the landmarks of chance
OVERLOOKED = 0.3  # how often the poses that one image proposes miss the true one
MOST = 0.0  # log-odds that unexplained edges alone never exceed: they may as well be new to the map


@dataclass(frozen=True, slots=True, eq=False)
class LostProbability:
    """log_odds: logarithm of the odds that the robot is lost, that is, that the truth is not among the particles.

    overlooked: probability that the true place was never among those that the particles were chosen from. inliers: the
    distribution of the inlier rate that was learnt here.
    """

    log_odds: float
    overlooked: float = 0.0
    inliers: InlierRate = field(default_factory=InlierRate.unknown)

    @classmethod
    def of(cls, probability: float) -> LostProbability:
        """Return that of a robot that is lost with this probability (0 to 1), before any global localisation."""
        return cls(_log_odds(probability))

    @classmethod
    def of_anywhere(cls, inliers: InlierRate | None = None) -> LostProbability:
        """Return that of a robot with particles wherever one image fits."""
        return cls(_log_odds(OVERLOOKED), OVERLOOKED, inliers or InlierRate.unknown())

    @property
    def probability(self) -> float:
        """The probability that the robot is lost."""
        return _probability(self.log_odds)

    def log_evidence(self, by_rate: Array, log_weight: Array) -> float:
        """Return log p(edges | particles), their weighted mean, relative to all edges being clutter.

        by_rate: (K, N) log p(edges | particle, w_k), relative to the same. log_weight: (N,) of the particles before.
        """
        log_likelihood = self.inliers.log_mean(by_rate)
        return log_sum(log_weight + log_likelihood) - log_sum(log_weight)

    def after(self, by_rate: Array, log_weight: Array, novelty: float, carried: float) -> LostProbability:
        """Return the probability after an image of this novelty, 0 … 1; the rest as for `log_evidence`.

        carried: probability of having been carried away since the last independent image.
        """
        lost = self.probability + carried * novelty * (1.0 - self.probability)
        inliers = self.inliers.after(novelty)
        learnt = inliers.given(by_rate, normalised(log_weight + inliers.log_mean(by_rate)), novelty)
        # Only an image that shows landmarks could have told of another place.
        shown = float((learnt.count - inliers.count)[INLIER_RATES > SOME].sum())
        overlooked = self.overlooked * OVERLOOKED**shown
        log_odds = _log_odds(lost) - novelty * self.log_evidence(by_rate, log_weight)
        return LostProbability(min(max(log_odds, _log_odds(overlooked)), MOST), overlooked, learnt)

    def joined(self, log_odds: float) -> LostProbability:
        """Return the probability after places that global localisation found have joined the particles.

        log_odds: of all these places against the particles. If these places win, they are what may be wrong.
        """
        found = _probability(log_odds)
        overlooked = OVERLOOKED * found + self.overlooked * (1.0 - found)
        left = self.log_odds + np.log(OVERLOOKED) - np.logaddexp(0.0, log_odds)
        return replace(self, log_odds=float(max(left, _log_odds(overlooked))), overlooked=overlooked)


def _log_odds(probability: float) -> float:
    with np.errstate(divide="ignore"):
        return float(np.log(probability) - np.log1p(-probability))


def _probability(log_odds: float) -> float:
    return float(np.exp(-np.logaddexp(0.0, -log_odds)))
