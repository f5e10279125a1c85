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
    multinomial_resample,
    normalised,
    only,
    spread,
    systematic_resample,
    take,
    thinned,
)
from localiser.particles.clusters import CELL_M, CELL_RAD, Clusters, cells_of, find_clusters
