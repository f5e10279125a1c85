"""Tempering: weigh particles by the edges of one image in stages, when the edges are much more accurate than the cloud.

Otherwise all weight would be on the few particles that happen to be nearest. Between stages that leave enough of them,
particles are resampled and spread by a small kernel [Musso, Oudjane, Le Gland 2001].
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from localiser import particles
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap
from localiser.observation import INLIER_RATES, EdgeObservation, InlierRate, Observation, Sighting, own_log_likelihood
from localiser.particles import MOST_STAGES, POSE, Particles, systematic_resample


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """Particles that an image has weighed, those that it had not weighed yet, and what is known of the inlier rate."""

    particles: Particles
    before: Particles
    inliers: InlierRate


@dataclass(frozen=True, slots=True, eq=False)
class Tempering:
    """How particles are weighed by one sighting.

    inliers: what is known of the inlier rate. novelty: 0 … 1, how much of the log-likelihood is new and is weighed.
    stage_below: fraction of effective samples that each stage leaves; 0: one stage.
    """

    observation: Observation
    landmark_map: LandmarkMap
    sighting: Sighting
    inliers: InlierRate
    novelty: float
    stage_below: float

    def weighed(self, moved: Particles, is_first: bool, rng: np.random.Generator) -> Weighed:
        """Return the particles, weighed.

        is_first: whether perhaps no particle fits at all, as at a start. Then edges are blurred first and sharpened
        from stage to stage.
        """
        coarser_rad: float | None = None
        before = moved
        for blur_rad in self._blurs(moved) if is_first else [0.0]:
            left = self.novelty
            for stage in range(MOST_STAGES):
                by_rate = self._by_rate(moved, blur_rad)
                log_likelihood = self.inliers.log_mean(by_rate)
                if coarser_rad is not None:  # which the particles have been weighed by already
                    log_likelihood = log_likelihood - self.inliers.log_mean(self._by_rate(moved, coarser_rad))
                fewest = self.stage_below * len(moved) if stage < MOST_STAGES - 1 else 0.0
                taken = particles.largest_step(moved.log_weight, log_likelihood, left, fewest)
                weighed = replace(moved, log_weight=moved.log_weight + taken * log_likelihood)
                left -= taken
                if left <= 0 and blur_rad == 0:
                    break
                index = systematic_resample(weighed.weight, len(weighed), rng)
                moved = particles.spread(particles.take(weighed, index), rng)
                if left <= 0:
                    break
            coarser_rad = blur_rad
        return Weighed(weighed, before, self.inliers.given(by_rate, weighed.weight, self.novelty))

    def _by_rate(self, moved: Particles, blur_rad: float) -> Array:
        if isinstance(self.observation, EdgeObservation):
            return self.observation.by_rate(moved, self.sighting, self.landmark_map, blur_rad)
        found = own_log_likelihood(self.observation, moved, self.sighting, self.landmark_map)
        return np.tile(found, (len(INLIER_RATES), 1))  # the same whatever the rate

    def _blurs(self, moved: Particles) -> list[float]:
        """Return the sigmas (rad) to blur edges by, from stage to stage, the last one 0.

        Only 0 where at least one particle is expected within an edge's sigma of the truth in every dimension. Else
        from twice the spread of the particles' predictions, halved until it is below the edges' sigma.
        """
        if not isinstance(self.observation, EdgeObservation):
            return [0.0]
        spread_rad, sigma_rad = self.observation.scales(moved, self.sighting, self.landmark_map)
        if len(moved) * sigma_rad ** len(POSE) >= spread_rad ** len(POSE):
            return [0.0]
        return [*(b for b in 2.0 * spread_rad * 0.5 ** np.arange(MOST_STAGES) if b > sigma_rad), 0.0]
