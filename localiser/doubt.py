"""Is the robot where any of the particles are? Odds of the contrary, from raw likelihoods.

Normalised weights cannot tell: of particles that are all wrong some are always the best. The likelihood itself can. It
is relative to all edges being clutter, which is what they are to a robot that is elsewhere, so each image multiplies
the odds of being lost by 1 / p(edges | particles). A right pose gives far more than 1, whatever share of the edges is
clutter; an image in which no landmark is found gives a little less than 1, as rarely as `inliers` has learnt that such
images come. An image that is only partly new counts for that part. Before each image there is a small chance that the
robot was carried away.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from localiser.geometry import Array
from localiser.inliers import InlierShare
from localiser.particles import normalised

SUREST = float(np.log(999.0))  # log-odds that are never exceeded: a model is never that right


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """log_odds: logarithm of the odds that the robot is lost, that is, that the truth is not among the particles.

    inliers: what share of the edges belongs to landmarks, as far as images tell that were seen while not lost.
    """

    log_odds: float
    inliers: InlierShare = field(default_factory=InlierShare.unknown)

    @classmethod
    def of(cls, probability: float) -> Doubt:
        """Return the doubt of a robot that is lost with this probability, between 0 and 1."""
        return cls(float(np.log(probability) - np.log1p(-probability)))

    @property
    def probability(self) -> float:
        """The probability that the robot is lost."""
        return float(np.exp(-np.logaddexp(0.0, -self.log_odds)))

    def after(self, by_share: Array, log_weight: Array, share: float, carried: float) -> Doubt:
        """Return the doubt after an image of which `share` (0 … 1) is new.

        by_share: (K, N) log p(edges | particle, w_k) relative to all edges being clutter. log_weight: (N,) of the
        particles before. carried: probability of having been carried away since the last independent image.
        """
        inliers = self.inliers.after(share)
        log_likelihood = inliers.log_mean(by_share)
        log_evidence = np.logaddexp.reduce(log_weight + log_likelihood) - np.logaddexp.reduce(log_weight)
        lost = self.probability + carried * share * (1.0 - self.probability)
        log_odds = np.log(lost) - np.log1p(-lost) - share * log_evidence if lost < 1.0 else SUREST
        doubt = replace(self, log_odds=float(np.clip(log_odds, -SUREST * 5, SUREST)))
        learnt = inliers.given(by_share, normalised(log_weight + log_likelihood), share)
        return replace(doubt, inliers=inliers.towards(learnt, 1.0 - doubt.probability))
