"""Weigh particles by the edges of one image, in stages where the edges are much sharper than the cloud.

Edges much sharper than the cloud would leave all weight on the few particles that happen to lie nearest. So only as
much of the evidence is taken at once as leaves a share of them effective; these are resampled and spread by a small
kernel, and the rest is weighed on the new, denser cloud [Musso, Oudjane, Le Gland 2001].
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from localiser import particles
from localiser.edges import Edges
from localiser.landmarks import LandmarkMap
from localiser.observation import InlierShare, Observation
from localiser.particles import MOST_STAGES, POSE, Particles, systematic_resample


@dataclass(frozen=True, slots=True, eq=False)
class Weighing:
    """How particles are weighed. stage_below: share of effective samples that each stage leaves; 0: one stage."""

    observation: Observation
    landmark_map: LandmarkMap
    stage_below: float

    def weigh(
        self,
        moved: Particles,
        edges: Edges,
        inliers: InlierShare,
        share: float,
        blurred: bool,
        rng: np.random.Generator,
    ) -> tuple[Particles, InlierShare]:
        """Return the particles with `share` of the edges' log-likelihood weighed, and what that tells of clutter.

        blurred: perhaps no particle fits at all, as at a start; then edges are blurred first and sharpened from stage
        to stage.
        """
        fewest = self.stage_below * len(moved)
        coarser_rad: float | None = None
        for blur_rad in self._blurs(moved, edges) if blurred else [0.0]:
            left = share
            for stage in range(MOST_STAGES):
                by_share = self.observation.by_share(moved, edges, self.landmark_map, blur_rad)
                log_likelihood = inliers.log_mean(by_share)
                if coarser_rad is not None:  # which the particles have been weighed by already
                    known = self.observation.by_share(moved, edges, self.landmark_map, coarser_rad)
                    log_likelihood = log_likelihood - inliers.log_mean(known)
                last = stage == MOST_STAGES - 1
                taken = left if last else particles.largest_step(moved.log_weight, log_likelihood, left, fewest)
                weighed = replace(moved, log_weight=moved.log_weight + taken * log_likelihood)
                left -= taken
                if left <= 0 and blur_rad == 0:
                    break
                index = systematic_resample(weighed.weight, len(weighed), rng)
                moved = particles.spread(particles.take(weighed, index), rng)
                if left <= 0:
                    break
            coarser_rad = blur_rad
        return weighed, inliers.given(by_share, weighed.weight, share)

    def at_once(
        self, moved: Particles, edges: Edges, inliers: InlierShare, share: float
    ) -> tuple[Particles, InlierShare] | None:
        """Return what `weigh` does, in one stage; None where that would leave too few effective samples."""
        by_share = self.observation.by_share(moved, edges, self.landmark_map)
        weighed = replace(moved, log_weight=moved.log_weight + share * inliers.log_mean(by_share))
        if particles.effective_sample_size(weighed.weight) < self.stage_below * len(moved):
            return None
        return weighed, inliers.given(by_share, weighed.weight, share)

    def _blurs(self, moved: Particles, edges: Edges) -> list[float]:
        """Return the sigmas (rad) to blur edges by, from stage to stage, the last one 0.

        Only 0 where at least one particle is expected within an edge's sigma of the truth in every dimension. Else
        from twice the spread of the particles' predictions, halved until it is below the edges' sigma.
        """
        spread_rad, sigma_rad = self.observation.scales(moved, edges, self.landmark_map)
        if len(moved) * sigma_rad ** len(POSE) >= spread_rad ** len(POSE):
            return [0.0]
        return [*(b for b in 2.0 * spread_rad * 0.5 ** np.arange(MOST_STAGES) if b > sigma_rad), 0.0]
