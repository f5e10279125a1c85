"""Is the robot where any of the particles are? Odds of the contrary, from raw likelihoods.

Normalised weights cannot tell: of particles that are all wrong some are always the best. The likelihood itself can. It
is relative to all edges being clutter, which is what they are to a robot that is elsewhere, so each image multiplies
the odds of being lost by 1 / p(edges | particles). A right pose gives far more than 1, whatever share of the edges is
clutter; an image in which no landmark is found gives a little less than 1, as rarely as `inliers` has learnt that such
images come. Before each image there is a small chance that the robot was carried away.

Images repeat each other. What fits, fits again as long as the same things are in view, also where it does so by chance:
that counts by how much of the scene is new. What does not fit counts by how much of the measuring errors is new, and an
image that fits although the last one did not, or the other way round, repeats nothing.

A wrong place may look like the right one: the other end of a corridor does. That its particles fit says nothing then;
what counts is whether the right place would have been found had it been another. So the robot stays lost with the
probability that all looks around have `overlooked` its place.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from localiser.geometry import Array
from localiser.inliers import INLIER_SHARES, InlierShare
from localiser.particles import normalised

SOME = 0.3  # of the edges: from here on they are not the landmarks of chance
OVERLOOKED = 0.4  # how often the poses that one image proposes miss the true one
MOST = 0.0  # log-odds that unexplained edges alone never exceed: they may as well be new to the map


@dataclass(frozen=True, slots=True)
class News:
    """What is new in an image, 0 … 1: of the errors with which edges are measured, and of the scene that it shows."""

    errors: float
    scene: float


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """log_odds: logarithm of the odds that the robot is lost, that is, that the truth is not among the particles.

    overlooked: probability that the true place was never among those that the particles were chosen from. inliers: what
    share of the edges belongs to landmarks hereabouts. fitted: whether the last image fitted better than clutter.
    """

    log_odds: float
    overlooked: float = 0.0
    fitted: bool = True
    inliers: InlierShare = field(default_factory=InlierShare.unknown)

    @classmethod
    def of(cls, probability: float) -> Doubt:
        """Return the doubt of a robot that is lost with this probability, between 0 and 1, and was never looked for."""
        return cls(_log_odds(probability))

    @classmethod
    def of_anywhere(cls, inliers: InlierShare | None = None) -> Doubt:
        """Return the doubt of a robot whose particles are where one image fits."""
        return cls(_log_odds(OVERLOOKED), OVERLOOKED, inliers=inliers or InlierShare.unknown())

    @property
    def probability(self) -> float:
        """The probability that the robot is lost."""
        return probability_of(self.log_odds)

    def log_evidence(self, by_share: Array, log_weight: Array) -> float:
        """Return log p(edges | particles), their weighted mean, relative to all edges being clutter.

        by_share: (K, N) log p(edges | particle, w_k), relative to the same. log_weight: (N,) of the particles before.
        """
        log_likelihood = self.inliers.log_mean(by_share)
        return float(np.logaddexp.reduce(log_weight + log_likelihood) - np.logaddexp.reduce(log_weight))

    def news(self, log_evidence: float, news: News) -> News:
        """Return what is new in an image: all of it, if it fits and the last one did not, or the other way round."""
        return news if (log_evidence > 0) == self.fitted else News(1.0, 1.0)

    def ahead(self, news: News, carried: float) -> Doubt:
        """Return the doubt before an image is looked at; carried: chance of being carried away since the last one."""
        lost = self.probability
        return replace(self, log_odds=_log_odds(lost + carried * news.errors * (1.0 - lost)))

    def after(self, by_share: Array, log_weight: Array, news: News) -> Doubt:
        """Return the doubt after an image; the rest as for `log_evidence`."""
        inliers = self.inliers.after(news.errors)
        weight = normalised(log_weight + inliers.log_mean(by_share))
        # Only an image that shows landmarks could have told of another place.
        shown = float((inliers.given(by_share, weight, news.scene).count - inliers.count)[INLIER_SHARES > SOME].sum())
        overlooked = self.overlooked * OVERLOOKED**shown
        evidence = self.log_evidence(by_share, log_weight)
        log_odds = self.log_odds - (news.scene if evidence > 0 else news.errors) * evidence
        learnt = inliers.given(by_share, weight, news.errors)
        return Doubt(min(max(log_odds, _log_odds(overlooked)), MOST), overlooked, evidence > 0, learnt)

    def joined(self, log_odds: float) -> Doubt:
        """Return the doubt after places that a look around found have joined the particles.

        log_odds: of all these places, beside the particles. Where they win, it is them that may be wrong.
        """
        found = probability_of(log_odds)
        overlooked = OVERLOOKED * found + self.overlooked * (1.0 - found)
        left = self.log_odds + np.log(OVERLOOKED) - np.logaddexp(0.0, log_odds)
        return replace(self, log_odds=float(max(left, _log_odds(overlooked))), overlooked=overlooked)


def _log_odds(probability: float) -> float:
    with np.errstate(divide="ignore"):
        return float(np.log(probability) - np.log1p(-probability))


def probability_of(log_odds: float) -> float:
    """Return the probability that these log-odds stand for."""
    return float(np.exp(-np.logaddexp(0.0, -log_odds)))
