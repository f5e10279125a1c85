"""The belief of the filter in addition to its particles: whether the robot is lost, and where else it may be.

It combines three parts: the probability of being lost (`LostProbability`), a second cloud of particles elsewhere
(`AlternativeHypothesis`), and the probability that an estimate is right (`confidence`). None of them changes the
particles of a robot that is where it is believed to be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from localiser import particles
from localiser.filter.alternative_hypothesis import AlternativeHypothesis
from localiser.filter.confidence import Reason, confidence_of, near_weight
from localiser.geometry import Array
from localiser.observation import Sighting
from localiser.particles import Clusters, Estimate, Particles, find_clusters, only
from localiser.relocalisation import SEEN_FIRST, GlobalLocalisation, LostProbability, resampled

STRAY_START = 0.01  # probability that a start that was stated is wrong
ALONE = 0.98  # weight of a place from which on the others are forgotten


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """lost: whether the robot is at none of the particles. alternative: where else it may be, beside the particles.

    is_global: whether the particles themselves are at several places.
    """

    lost: LostProbability = field(default_factory=lambda: LostProbability.of(STRAY_START))
    alternative: AlternativeHypothesis | None = None
    is_global: bool = False

    @classmethod
    def anywhere(
        cls, search: GlobalLocalisation, origin: Particles, sighting: Sighting, rng: np.random.Generator
    ) -> tuple[Particles, Belief]:
        """Return particles where the image fits, of a robot that may be anywhere. origin: particles at any one pose."""
        belief = cls(LostProbability.of_anywhere(), is_global=True)
        clues = search.clues(sighting)
        return search.fresh(origin, clues, belief.lost.inliers, len(origin), rng)[0], belief

    def followed(
        self,
        search: GlobalLocalisation,
        moved: Particles,
        sighting: Sighting,
        novelty: float,
        rng: np.random.Generator,
    ) -> tuple[Particles, Belief]:
        """Return particles at several places, moved, then weighed by an image and joined by places that it proposes."""
        weighed, lost, _ = search.followed(moved, self.lost, search.clues(sighting), novelty, rng)
        return weighed, replace(self, lost=lost)

    def compared(
        self,
        search: GlobalLocalisation,
        few: Particles,
        weighed: Particles,
        sighting: Sighting,
        novelty: float,
        move: Callable[[Particles], Particles],
        rng: np.random.Generator,
    ) -> tuple[Particles, Belief]:
        """Return the particles, or those of an alternative that has won, and the belief after an image.

        few: some of the particles, moved by odometry alone. weighed: all of them, weighed by the image. move: moves
        particles since the last image.
        """
        clues, alternative = search.clues(sighting), self.alternative
        by_rate = clues.by_rate(few)
        log_evidence = self.lost.log_evidence(by_rate, few.log_weight)
        lost = self.lost.after(by_rate, few.log_weight, novelty, search.parameters.carried)
        if alternative is not None:
            moved, given = move(alternative.particles), novelty * log_evidence
            alternative = alternative.followed(search, moved, clues, novelty, given, self.lost.inliers, rng)
        elif search.is_needed(lost, clues, novelty):
            log_odds = self.lost.log_odds - log_evidence
            alternative = AlternativeHypothesis.begun(search, weighed, lost.inliers, log_odds, clues, rng)
        if alternative is not None:
            alternative = alternative.elsewhere(particles.estimate(weighed).pose)
        if alternative is not None and alternative.has_won:
            return alternative.particles, Belief(alternative.lost, is_global=True)
        return weighed, Belief(lost, alternative)

    def places(self, weighed: Particles) -> tuple[Estimate, Clusters]:
        """Return the estimate, at the likeliest place where there are several, and all the places."""
        clusters = find_clusters(weighed.poses, weighed.weight)
        estimate = particles.estimate(only(weighed, clusters.label == 0) if self.is_global else weighed)
        if self.alternative is not None:
            others = self.alternative.particles
            clusters = clusters.beside(find_clusters(others.poses, others.weight), self.alternative.probability)
        return estimate, clusters

    def confidence(self, weighed: Particles, pose: Array, sighting: Sighting) -> tuple[float, Reason]:
        """Return the probability that the estimate `pose` (3,) is correct, and why it is low, "" where it is not."""
        p_elsewhere = 0.0 if self.alternative is None else self.alternative.probability
        is_empty = len(sighting.edges) == 0 and sighting.measurement is None
        return confidence_of(weighed, pose, max(self.lost.probability, p_elsewhere), is_empty)

    def resampled(
        self, search: GlobalLocalisation | None, weighed: Particles, pose: Array, count: int, rng: np.random.Generator
    ) -> tuple[Particles | None, Belief]:
        """Return particles at several places, equally weighted; None where one place, that of `pose` (3,), has won.

        count: the fewest particles. Those of an alternative are resampled with them.
        """
        alternative = self.alternative
        if alternative is not None:
            alternative = alternative.resampled(count, max(count, SEEN_FIRST), rng)
        if self.is_global and search is not None and near_weight(weighed, pose) < ALONE:
            return resampled(weighed, count, max(count, search.most), rng), replace(self, alternative=alternative)
        return None, Belief(self.lost, alternative)
