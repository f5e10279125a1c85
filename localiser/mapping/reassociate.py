"""Associate every edge again, with the landmark that explains it best now that landmarks are better known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.mapping.association import assign, association_scores, looks_alike
from localiser.mapping.landmarks import Built
from localiser.mapping.parameters import MappingParameters
from localiser.mapping.sightings import Index, Sightings, direction_of, per_point


def reassociate(
    sightings: Sightings,
    built: Built,
    cameras: Array,
    sigma: Array,
    parameters: MappingParameters,
    margin: float = 0.0,
) -> Index:
    """Return the landmark (S,) of each sighting, -1 for none; see `Sightings`. cameras: (T, 3). sigma: (S,) rad.
    margin: see `assign`.

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
            from_here = np.tile(cameras[frame], (len(landmark), 1))
            expected, _ = direction_of(built.fit.points[landmark], from_here)
            jacobian = per_point(built.fit.points[landmark], from_here)
            own = np.einsum("li,lij,lj->l", jacobian, cov[landmark], jacobian)
            looks = looks_alike(
                built.side[landmark, None],
                built.polarity[landmark, None],
                sightings.side[seen],
                sightings.polarity[seen],
            )
            heading = cameras[frame, 2] - sightings.bearing[seen]
            score = association_scores(expected, own, heading, sigma[seen], looks, parameters.tracks)
            row, column = assign(score, margin)
            of[seen[column]] = landmark[row]
    return of


def _live(sightings: Sightings, built: Built, reach: int) -> list[Index]:
    """Return for each frame the landmarks that are seen within `reach` frames of it."""
    seen: NDArray[np.bool_] = np.zeros((sightings.frames, len(built)), dtype=bool)
    seen[sightings.frame[built.used], built.of[built.used]] = True
    near = seen.copy()
    for step in range(1, reach + 1):
        near[step:] |= seen[:-step]
        near[:-step] |= seen[step:]
    return [np.flatnonzero(row) for row in near]
