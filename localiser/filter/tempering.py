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


def weighed_in_stages(
    moved: Particles,
    observation: Observation,
    sighting: Sighting,
    landmark_map: LandmarkMap,
    inliers: InlierRate,
    novelty: float,
    stage_below: float,
    rng: np.random.Generator,
    *,
    is_first: bool,
) -> Weighed:
    """Return the particles, weighed by one sighting.

    inliers: what is known of the inlier rate. novelty: 0 … 1, how much of the log-likelihood is new and is weighed.
    stage_below: fraction of effective samples that each stage leaves; 0: one stage. is_first: whether perhaps no
    particle fits at all, as at a start. Then edges are blurred by twice the spread of the particles' predictions and
    sharpened from stage to stage, unless a particle is expected within an edge's sigma of the truth in all dimensions.
    """

    def by_rate_of(cloud: Particles, blur_rad: float) -> Array:
        if isinstance(observation, EdgeObservation):
            return observation.by_rate(cloud, sighting, landmark_map, blur_rad)
        found = own_log_likelihood(observation, cloud, sighting, landmark_map)
        return np.tile(found, (len(INLIER_RATES), 1))  # the same whatever the rate

    blurs_rad: list[float] = [0.0]
    if is_first and isinstance(observation, EdgeObservation):
        spread_rad, sigma_rad = observation.scales(moved, sighting, landmark_map)
        if len(moved) * sigma_rad ** len(POSE) < spread_rad ** len(POSE):
            wide_rad = 2.0 * spread_rad * 0.5 ** np.arange(MOST_STAGES)
            blurs_rad = [*wide_rad[wide_rad > sigma_rad], 0.0]
    coarser_rad: float | None = None
    before = moved
    for blur_rad in blurs_rad:
        left = novelty
        for stage in range(MOST_STAGES):
            by_rate = by_rate_of(moved, blur_rad)
            log_likelihood = inliers.log_mean(by_rate)
            if coarser_rad is not None:  # which the particles have been weighed by already
                log_likelihood = log_likelihood - inliers.log_mean(by_rate_of(moved, coarser_rad))
            fewest = stage_below * len(moved) if stage < MOST_STAGES - 1 else 0.0
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
    return Weighed(weighed, before, inliers.given(by_rate, weighed.weight, novelty))
