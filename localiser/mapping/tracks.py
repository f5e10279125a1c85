"""Track edges from image to image: a Kalman filter of direction and inverse distance for each track, in batches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.geometry import Array, wrap_angle
from localiser.mapping.association import TrackParameters, assign, association_scores, looks_alike
from localiser.mapping.inverse_depth import first_state, predicted, updated
from localiser.mapping.sightings import Index, Sightings


@dataclass(slots=True, eq=False)
class _Tracks:
    """The tracks that are alive, K of them, as columns.

    id: (K,). origin: (K, 2) camera position at the first sighting. state, cov: (K, 2), (K, 2, 2), see `inverse_depth`.
    last: (K,) latest sighting. missed: (K,) frames since.
    """

    id: Index
    origin: Array
    state: Array
    cov: Array
    last: Index
    missed: Index

    @classmethod
    def begun(cls, id: Index, camera: Array, state: Array, cov: Array, last: Index) -> _Tracks:
        return cls(id, np.tile(camera[:2], (len(id), 1)), state, cov, last, np.zeros(len(id), dtype=np.int64))

    def take(self, index: Index) -> _Tracks:
        return _Tracks(*(getattr(self, name)[index] for name in self.__slots__))

    def join(self, other: _Tracks) -> _Tracks:
        return _Tracks(*(np.concatenate([getattr(self, n), getattr(other, n)]) for n in self.__slots__))


def follow(
    sightings: Sightings, cameras: Array, pose_sigma_rad: Array, parameters: TrackParameters, margin: float = 0.0
) -> Index:
    """Return the track (S,) of each sighting, numbered from 0 in the order of their first sightings.

    cameras: (T, 3) floor poses of the camera; only their relation over a few frames matters. pose_sigma_rad: (T,)
    error of the turn since the frame before, as far as it is known.
    margin: see `assign`; an edge that is no clear match of one track begins another.
    """
    track, count, none = np.full(len(sightings), -1, dtype=np.int64), 0, np.zeros(0, dtype=np.int64)
    alive = _Tracks.begun(none, np.zeros(3), *first_state(np.zeros(0), np.zeros(0), 1.0), none)
    for frame, camera in enumerate(cameras):
        seen = np.arange(sightings.first[frame], sightings.first[frame + 1])
        heading = camera[2] - sightings.bearing[seen]
        sigma = np.hypot(sightings.sigma[seen], pose_sigma_rad[frame])
        expected, jacobian = predicted(alive.origin, alive.state, camera)
        row, column = none, none
        if len(seen) and len(alive.id):
            own = np.einsum("ki,kij,kj->k", jacobian, alive.cov, jacobian)
            side, polarity = sightings.side, sightings.polarity
            looks = looks_alike(side[alive.last, None], polarity[alive.last, None], side[seen], polarity[seen])
            row, column = assign(association_scores(expected, own, heading, sigma, looks, parameters), margin)
        innovation = wrap_angle(heading[column] - expected[row])
        alive.state[row], alive.cov[row] = updated(
            alive.state[row], alive.cov[row], innovation, jacobian[row], sigma[column]
        )
        alive.missed += 1
        alive.last[row], alive.missed[row] = seen[column], 0
        track[seen[column]] = alive.id[row]
        fresh = np.delete(np.arange(len(seen)), column)
        track[seen[fresh]] = count + np.arange(len(fresh))
        count += len(fresh)
        begun = first_state(heading[fresh], sigma[fresh], parameters.nearest_m)
        alive = alive.take(np.flatnonzero(alive.missed <= parameters.missed_most))
        alive = alive.join(_Tracks.begun(track[seen[fresh]], camera, *begun, seen[fresh]))
    return track
