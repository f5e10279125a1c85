"""Give every edge anew to the landmark that explains it best, now that landmarks are known better than tracks were."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, wrap_angle
from localiser.mapping.assign import assign
from localiser.mapping.landmarks import Built
from localiser.mapping.likeness import log_likeness
from localiser.mapping.parameters import MappingParameters
from localiser.mapping.sightings import Index, Sightings, direction_of, per_point

_NARROWEST_SPAN_RAD = np.deg2rad(20.0)


def reassociate(
    sightings: Sightings, built: Built, cameras: Array, sigma: Array, parameters: MappingParameters
) -> Index:
    """Return the landmark (S,) of each sighting, -1 for none; see `Sightings`. cameras: (T, 3). sigma: (S,) rad.

    A landmark competes for the edges of a frame when it is seen shortly before or after it: farther off it may be
    hidden, and then some other edge in its direction would be taken for it.
    """
    live = _live(sightings, built, parameters.tracks.missed_most + 1)
    of = np.full(len(sightings), -1, dtype=np.int64)
    cov = built.cov
    for frame in range(sightings.frames):
        seen = np.arange(sightings.first[frame], sightings.first[frame + 1])
        landmark = live[frame]
        if len(seen) and len(landmark):
            score = match_scores(sightings, seen, built, cov, landmark, cameras[frame], sigma, parameters)
            row, column = assign(score)
            of[seen[column]] = landmark[row]
    return of


def match_scores(
    sightings: Sightings,
    seen: Index,
    built: Built,
    cov: Array,
    landmark: Index,
    camera: Array,
    sigma: Array,
    parameters: MappingParameters,
) -> Array:
    """Return the log-likelihood ratios (B, A) of landmarks (B) showing in the sightings (A) of one frame.

    Against the landmark being missed and the sighting being of something unknown, anywhere in view.
    """
    from_here = np.tile(camera, (len(landmark), 1))
    predicted, _ = direction_of(built.fit.points[landmark], from_here)
    jacobian = per_point(built.fit.points[landmark], from_here)
    own = np.einsum("li,lij,lj->l", jacobian, cov[landmark], jacobian)
    innovation = wrap_angle(camera[2] - sightings.bearing[seen][None] - predicted[:, None])
    variance = own[:, None] + sigma[seen][None] ** 2
    fit = -0.5 * innovation**2 / variance - 0.5 * np.log(2 * np.pi * variance)
    looks = log_likeness(built.side[landmark], built.polarity[landmark], sightings.side[seen], sightings.polarity[seen])
    tracks = parameters.tracks
    span = max(float(np.ptp(sightings.bearing[seen])), _NARROWEST_SPAN_RAD)
    odds = tracks.found / (1 - tracks.found)
    score = fit + looks + np.log(odds * span / max(tracks.new_share * len(seen), 1.0))
    score[innovation**2 > tracks.gate_sigma**2 * variance] = -np.inf
    return np.asarray(score)


def _live(sightings: Sightings, built: Built, reach: int) -> list[Index]:
    """Return for each frame the landmarks that are seen within `reach` frames of it."""
    seen: NDArray[np.bool_] = np.zeros((sightings.frames, len(built)), dtype=bool)
    seen[sightings.frame[built.used], built.of[built.used]] = True
    near = seen.copy()
    for step in range(1, reach + 1):
        near[step:] |= seen[:-step]
        near[:-step] |= seen[step:]
    return [np.flatnonzero(row) for row in near]
