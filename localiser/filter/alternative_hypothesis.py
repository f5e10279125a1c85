"""An alternative hypothesis: a second cloud of particles at another place where the robot may be.

While the robot may be lost, a second cloud follows the images. It begins at poses that these images proposed. It
carries the odds that it is right and the first cloud is wrong:

    odds = odds of being lost · mean of prior/q · p(edges | pose) / p(edges | particles),  at the image that began it,
    then times p(edges | alternative) / max(p(edges | particles), p(edges | clutter)) at every further image.

The first cloud does not change, so a robot that is well localised is not affected. An alternative that explains the
edges less well is given up. One that explains them better replaces the first cloud, after any number of images.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from localiser.filter.confidence import is_near
from localiser.geometry import Array
from localiser.observation import InlierRate
from localiser.particles import Particles, find_clusters, only
from localiser.relocalisation import Clues, GlobalLocalisation, LostProbability, resampled

WON = float(np.log(1000.0))  # odds from which on the alternative takes over
MOST = 0.8  # of its weight that one place must have
DEAD = -20.0  # log-odds below which it is given up


@dataclass(frozen=True, slots=True, eq=False)
class AlternativeHypothesis:
    """particles: where else the robot may be. lost: whether it is at none of these either.

    log_odds: logarithm of the odds that it is there, against where it is believed to be.
    """

    particles: Particles
    lost: LostProbability
    log_odds: float

    @property
    def has_won(self) -> bool:
        """Whether the robot is to be believed there: the odds say so, and one place has most of the weight."""
        if self.log_odds <= WON:
            return False
        return float(find_clusters(self.particles.poses, self.particles.weight).weight[0]) > MOST

    @property
    def probability(self) -> float:
        """Probability that the robot is there, and not where it is believed to be."""
        return float(np.exp(-np.logaddexp(0.0, -self.log_odds)))

    @classmethod
    def begun(
        cls,
        search: GlobalLocalisation,
        like: Particles,
        inliers: InlierRate,
        log_odds: float,
        clues: Clues,
        rng: np.random.Generator,
    ) -> AlternativeHypothesis | None:
        """Return the places that an image proposes, None where they are not worth following.

        like: the particles that are believed. log_odds: of their being wrong, all of the image weighed against them.
        """
        fresh, log_evidence = search.fresh(like, clues, inliers, search.parameters.fresh, rng)
        return cls(fresh, LostProbability.of_anywhere(inliers), log_odds + log_evidence)._alive()

    def followed(
        self,
        search: GlobalLocalisation,
        moved: Particles,
        clues: Clues,
        novelty: float,
        log_evidence: float,
        inliers: InlierRate,
        rng: np.random.Generator,
    ) -> AlternativeHypothesis | None:
        """Return the alternative after an image of this novelty, None when it is given up.

        moved: its particles, moved since the last image. log_evidence: what the believed particles gave the image.
        inliers: the inlier rate, the same for both.
        """
        weighed, lost, own = search.followed(moved, replace(self.lost, inliers=inliers), clues, novelty, rng)
        # It wins by what it explains, not by what the others leave unexplained: that may be new to the map.
        return AlternativeHypothesis(weighed, lost, self.log_odds + own - max(log_evidence, 0.0))._alive()

    def elsewhere(self, pose: Array) -> AlternativeHypothesis | None:
        """Return the alternative without what is near the believed pose (3,), None where nothing else is left."""
        far = ~is_near(self.particles.poses, pose)
        left = float(self.particles.weight[far].sum())
        if left <= 0:
            return None
        return AlternativeHypothesis(only(self.particles, far), self.lost, self.log_odds + float(np.log(left)))._alive()

    def resampled(self, fewest: int, most: int, rng: np.random.Generator) -> AlternativeHypothesis:
        """Return the alternative with equally weighted particles."""
        return replace(self, particles=resampled(self.particles, fewest, most, rng))

    def _alive(self) -> AlternativeHypothesis | None:
        return self if self.log_odds > DEAD else None
