"""Another place where the robot may be, followed beside the one where it is believed to be.

While the robot may be lost, a second cloud of particles follows the images from poses that these proposed, with the
odds that it is right and the first one wrong:

    odds = odds of being lost · mean of prior/q · p(edges | pose) / p(edges | particles),  at the image that began it,
    then times p(edges | rival) / max(p(edges | particles), p(edges | clutter)) at every further image.

The first cloud is not touched by this, so a robot that is well localised comes to no harm; a rival that explains the
edges less well dies out, and one that explains them better wins, however many images it takes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from localiser.filter.confidence import beside
from localiser.geometry import Array
from localiser.observation import InlierShare
from localiser.particles import Particles, find_clusters
from localiser.relocalisation import Clues, Doubt, Search, only, resampled

WON = float(np.log(1000.0))  # odds from which on the rival takes over
MOST = 0.8  # of a rival's weight that one place must have
DEAD = -20.0  # log-odds below which it is given up


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """particles: where else the robot may be. doubt: whether it is at none of these either.

    log_odds: logarithm of the odds that it is there, against where it is believed to be.
    """

    particles: Particles
    doubt: Doubt
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
        cls, search: Search, like: Particles, doubt: Doubt, log_odds: float, clues: Clues, rng: np.random.Generator
    ) -> Rival | None:
        """Return the places that an image proposes, None where they are not worth following.

        like: the particles that are believed. log_odds: of their being wrong, all of the image weighed against them.
        """
        fresh, log_evidence = search.fresh(like, clues, doubt.inliers, search.parameters.fresh, rng)
        return cls(fresh, Doubt.of_anywhere(doubt.inliers), log_odds + log_evidence)._alive()

    def followed(
        self,
        search: Search,
        moved: Particles,
        clues: Clues,
        share: float,
        log_evidence: float,
        inliers: InlierShare,
        rng: np.random.Generator,
    ) -> Rival | None:
        """Return the rival after an image of which `share` is new, None when it is given up.

        moved: its particles, moved since the last image. log_evidence: what the believed particles gave the image.
        inliers: how much is clutter, the same for both.
        """
        doubt = replace(self.doubt, inliers=inliers)
        weighed, doubt, own_evidence = search.followed(moved, doubt, clues, share, rng)
        # It wins by what it explains, not by what the others leave unexplained: that may be new to the map.
        return Rival(weighed, doubt, self.log_odds + own_evidence - max(log_evidence, 0.0))._alive()

    def elsewhere(self, pose: Array) -> Rival | None:
        """Return the rival without what is beside the believed pose (3,), None where nothing else is left."""
        far = ~beside(self.particles.poses, pose)
        weight = self.particles.weight
        left = float(weight[far].sum())
        if left <= 0:
            return None
        return Rival(only(self.particles, far), self.doubt, self.log_odds + float(np.log(left)))._alive()

    def resampled(self, fewest: int, most: int, rng: np.random.Generator) -> Rival:
        """Return the rival with equally weighted particles."""
        return Rival(resampled(self.particles, fewest, most, rng), self.doubt, self.log_odds)

    def _alive(self) -> Rival | None:
        return self if self.log_odds > DEAD else None
