"""Weighted particles: the cloud, its estimate, resampling, clusters."""

from localiser.particles.cloud import (
    CAMERA_YAW,
    MOST_STAGES,
    POSE,
    Estimate,
    Particles,
    centred,
    effective_sample_size,
    estimate,
    from_gaussian,
    largest_step,
    log_sum,
    normalised,
    only,
    spread,
    take,
)
from localiser.particles.clusters import Clusters, find_clusters, poses_per_cell
from localiser.particles.resampling import enough_particles, multinomial_resample, systematic_resample
