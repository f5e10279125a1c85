"""Landmarks from known poses: track, triangulate, join, and associate again until nothing changes."""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array
from localiser.mapping.coarse_bearings import landmarks_of_coarse_bearings
from localiser.mapping.landmarks import Built, fit_landmarks, join_tracks, long_enough, renumber
from localiser.mapping.parameters import MappingParameters
from localiser.mapping.reassociate import reassociate
from localiser.mapping.sightings import Index, Sightings

_ROUNDS = 6


def build_from_poses(
    sightings: Sightings, track: Index, cameras: Array, sigma: Array, parameters: MappingParameters
) -> Built:
    """Return the landmarks that tracks (S,) make, seen from cameras (T, 3), with bearing errors sigma (S,) rad."""
    built = join_tracks(sightings, long_enough(track), cameras, sigma, parameters)
    for _ in range(_ROUNDS):
        of = reassociate(sightings, built, cameras, sigma, parameters)
        if (of == built.of).all():
            break
        built = join_tracks(sightings, with_leftovers(of, track), cameras, sigma, parameters)
    return built


def build_from_coarse(sightings: Sightings, cameras: Array, sigma: Array, parameters: MappingParameters) -> Built:
    """Return the landmarks of bearings too coarse to be followed, from cameras (T, 3) at true poses."""
    of = landmarks_of_coarse_bearings(sightings, cameras, sigma, parameters.range_max_m)
    return fit_landmarks(sightings, renumber(long_enough(of)), cameras, sigma)


def with_leftovers(of: Index, track: Index) -> Index:
    """Return the landmarks `of` (S,), and what no landmark took as groups by its tracks (S,)."""
    left = of < 0
    rest = long_enough(np.where(left, track, -1))
    return renumber(long_enough(np.where(left & (rest >= 0), rest + of.max(initial=-1) + 1, of)))
