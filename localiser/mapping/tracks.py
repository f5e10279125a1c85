"""Follow edges from frame to frame.

A track is a direction from where it was first seen, and an inverse distance along it [Civera, Davison, Montiel 2008]:
nearly linear in what a camera measures whether the edge is near, far, or of unknown distance. An extended Kalman filter
per track predicts where the edge is in the next frame and how certain that is; all tracks are filtered at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from localiser.geometry import Array, forward, wrap_angle
from localiser.mapping.assign import assign
from localiser.mapping.likeness import log_likeness
from localiser.mapping.sightings import Index, Sightings


@dataclass(frozen=True, slots=True)
class TrackParameters:
    """How edges are followed."""

    nearest_m: Annotated[float, Field(gt=0, description="distance that few edges fall below (m)")] = 1.0
    found: Annotated[float, Field(gt=0, lt=1, description="chance that an edge is found again in the next image")] = 0.8
    new_share: Annotated[float, Field(gt=0, le=1, description="share of edges that the image before did not show")] = (
        0.3
    )
    missed_most: Annotated[int, Field(ge=0, description="images that a track may miss in a row")] = 4
    gate_sigma: Annotated[float, Field(gt=0, description="how far an edge may be from its prediction (sigmas)")] = 4.0


@dataclass(slots=True, eq=False)
class _Tracks:
    """The tracks that are alive, K of them, as columns.

    id: (K,). origin: (K, 2) camera position at the first sighting. state: (K, 2) heading and inverse distance. cov:
    (K, 2, 2). last: (K,) latest sighting. missed: (K,) frames since.
    """

    id: Index
    origin: Array
    state: Array
    cov: Array
    last: Index
    missed: Index

    def take(self, index: Index) -> _Tracks:
        return _Tracks(*(getattr(self, name)[index] for name in self.__slots__))

    def join(self, other: _Tracks) -> _Tracks:
        return _Tracks(*(np.concatenate([getattr(self, n), getattr(other, n)]) for n in self.__slots__))


def follow(sightings: Sightings, cameras: Array, pose_sigma_rad: Array, parameters: TrackParameters) -> Index:
    """Return the track (S,) of each sighting, numbered from 0 in the order of their first sightings.

    cameras: (T, 3) floor poses of the camera; only their relation over a few frames matters. pose_sigma_rad: (T,)
    error of the turn since the frame before, as far as it is known.
    """
    track = np.full(len(sightings), -1, dtype=np.int64)
    alive = _Tracks(*(np.zeros(shape, dtype=kind) for shape, kind in _EMPTY))
    count = 0
    for frame in range(sightings.frames):
        seen = np.arange(sightings.first[frame], sightings.first[frame + 1])
        heading, sigma = cameras[frame, 2] - sightings.bearing[seen], sightings.sigma[seen]
        sigma = np.hypot(sigma, pose_sigma_rad[frame])
        predicted, jacobian = _predict(alive, cameras[frame])
        row, column = _match(alive, predicted, jacobian, sightings, seen, heading, sigma, parameters)
        _update(alive, row, wrap_angle(heading[column] - predicted[row]), jacobian[row], sigma[column])
        alive.missed += 1
        alive.last[row], alive.missed[row] = seen[column], 0
        track[seen[column]] = alive.id[row]
        alive = alive.take(np.flatnonzero(alive.missed <= parameters.missed_most))
        fresh = np.delete(np.arange(len(seen)), column)
        track[seen[fresh]] = count + np.arange(len(fresh))
        alive = alive.join(
            _start(track[seen[fresh]], seen[fresh], cameras[frame], heading[fresh], sigma[fresh], parameters)
        )
        count += len(fresh)
    return track


_EMPTY = (((0,), int), ((0, 2), float), ((0, 2), float), ((0, 2, 2), float), ((0,), int), ((0,), int))


def _start(id: Index, last: Index, camera: Array, heading: Array, sigma: Array, parameters: TrackParameters) -> _Tracks:
    """Return new tracks of unknown distance: between nearest and infinity within two sigmas."""
    count = len(id)
    inverse = 1 / (3 * parameters.nearest_m)
    cov = np.zeros((count, 2, 2))
    cov[:, 0, 0], cov[:, 1, 1] = sigma**2, inverse**2
    state = np.stack([heading, np.full(count, inverse)], axis=-1)
    return _Tracks(id, np.tile(camera[:2], (count, 1)), state, cov, last, np.zeros(count, dtype=np.int64))


def _predict(tracks: _Tracks, camera: Array) -> tuple[Array, Array]:
    """Return the heading (K,) under which the camera (3,) sees each track, and its derivative by the state (K, 2)."""
    baseline = tracks.origin - camera[:2]
    ray = forward(tracks.state[:, 0]) + tracks.state[:, 1:] * baseline
    squared = np.maximum((ray**2).sum(axis=1), 1e-12)
    by_ray = np.stack([ray[:, 1], -ray[:, 0]], axis=-1) / squared[:, None]
    turned = forward(tracks.state[:, 0] + np.pi / 2)
    jacobian = np.stack([(by_ray * turned).sum(axis=1), (by_ray * baseline).sum(axis=1)], axis=-1)
    return np.arctan2(-ray[:, 0], -ray[:, 1]), jacobian


def _match(
    tracks: _Tracks,
    predicted: Array,
    jacobian: Array,
    sightings: Sightings,
    seen: Index,
    heading: Array,
    sigma: Array,
    parameters: TrackParameters,
) -> tuple[Index, Index]:
    """Return which track (row) belongs to which sighting of the frame (column)."""
    if len(seen) == 0 or len(tracks.id) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    innovation = wrap_angle(heading[None] - predicted[:, None])
    variance = np.einsum("ki,kij,kj->k", jacobian, tracks.cov, jacobian)[:, None] + sigma[None] ** 2
    fit = -0.5 * innovation**2 / variance - 0.5 * np.log(2 * np.pi * variance)
    # Against a track that is missed, and an edge that is new and may be anywhere in view.
    span = max(float(np.ptp(heading)), np.deg2rad(20.0))
    last = tracks.last
    looks = log_likeness(sightings.side[last], sightings.polarity[last], sightings.side[seen], sightings.polarity[seen])
    odds = parameters.found / (1 - parameters.found)
    score = fit + np.log(odds * span / max(parameters.new_share * len(seen), 1.0)) + looks
    score[innovation**2 > parameters.gate_sigma**2 * variance] = -np.inf
    return assign(score)


def _update(tracks: _Tracks, row: Index, innovation: Array, jacobian: Array, sigma: Array) -> None:
    """Take one measurement into each of the tracks (M,) `row`: the Kalman filter's update for a scalar."""
    cov = tracks.cov[row]
    gain = np.einsum("mij,mj->mi", cov, jacobian)
    variance = (gain * jacobian).sum(axis=1) + sigma**2
    gain /= variance[:, None]
    tracks.state[row] += gain * innovation[:, None]
    tracks.state[row, 1] = np.maximum(tracks.state[row, 1], 0.0)
    left = np.eye(2) - gain[:, :, None] * jacobian[:, None, :]
    # Joseph's form keeps the covariance symmetric and positive.
    noise = gain[:, :, None] * gain[:, None, :] * (sigma**2)[:, None, None]
    tracks.cov[row] = left @ cov @ left.transpose(0, 2, 1) + noise
