"""Track edges from image to image: a Kalman filter of direction and inverse distance for each track."""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array
from localiser.mapping.association import TrackParameters
from localiser.mapping.sightings import Index, Sightings


def follow(
    sightings: Sightings, cameras: Array, pose_sigma_rad: Array, parameters: TrackParameters, margin: float = 0.0
) -> Index:
    """Return the track (S,) of each sighting, numbered from 0 in the order of their first sightings.

    cameras: (T, 3) floor poses of the camera; only their relation over a few frames matters. pose_sigma_rad: (T,)
    error of the turn since the frame before, as far as it is known.
    margin: see `assign`; an edge that is no clear match of one track begins another.
    """
    from localiser.mapping.tracks_kernel import follow_loop

    track, edges = np.full(len(sightings), -1, dtype=np.int64), np.diff(sightings.first)
    # Each track that is alive was seen in one of the latest images.
    alive = np.convolve(edges, np.ones(parameters.missed_most + 2, dtype=np.int64)).max(initial=0)
    follow_loop(
        sightings.first,
        np.ascontiguousarray(sightings.bearing, dtype=np.float64),
        np.ascontiguousarray(sightings.sigma, dtype=np.float64),
        sightings.polarity,
        np.ascontiguousarray(sightings.side, dtype=np.float64),
        np.ascontiguousarray(cameras, dtype=np.float64),
        np.ascontiguousarray(pose_sigma_rad, dtype=np.float64),
        parameters.found,
        parameters.new_share,
        parameters.gate_sigma,
        parameters.nearest_m,
        parameters.missed_most,
        float(margin),
        int(alive),
        int(edges.max(initial=0)),
        track,
    )
    return track
