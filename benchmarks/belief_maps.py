"""Maps that are not of the building, or not quite: null worlds on which nothing can be right, and worn right ones.

A rigid motion of a map is a change of pose and no null world. A mirrored map is one, and so is a map whose blocks of
1.5 m are turned and shifted each for itself: it keeps how landmarks cluster, and loses where clusters are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from localiser.landmarks import LandmarkMap

BLOCK_M = 1.5
WORN, MOVED_M = 0.3, 0.3  # share of the landmarks, and how far


def mirrored(landmark_map: LandmarkMap) -> LandmarkMap:
    """Return the map with left and right exchanged, about its middle; polarities with them."""
    middle = landmark_map.points[:, 0].mean()
    points = landmark_map.points * [-1.0, 1.0] + [2 * middle, 0.0]
    cov = landmark_map.cov * [[1.0, -1.0], [-1.0, 1.0]]
    return replace(landmark_map, points=points, cov=cov, polarity=-landmark_map.polarity, quality=None)


def shuffled(landmark_map: LandmarkMap, seed: int) -> LandmarkMap:
    """Return the map with its blocks turned about their middles and shifted by up to half a block."""
    rng = np.random.default_rng([seed, 11])
    corner = landmark_map.points.min(axis=0) - rng.uniform(0.0, BLOCK_M, 2)
    block, of = np.unique(np.floor((landmark_map.points - corner) / BLOCK_M), axis=0, return_inverse=True)
    middle = (corner + (block + 0.5) * BLOCK_M)[of.ravel()]
    angle = rng.uniform(-np.pi, np.pi, len(block))[of.ravel()]
    shift = rng.uniform(-BLOCK_M / 2, BLOCK_M / 2, (len(block), 2))[of.ravel()]
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.stack([np.stack([cosine, -sine], axis=-1), np.stack([sine, cosine], axis=-1)], axis=-2)
    points = middle + np.einsum("lij,lj->li", turn, landmark_map.points - middle) + shift
    cov = turn @ landmark_map.cov @ turn.transpose(0, 2, 1)
    polarity = np.zeros_like(landmark_map.polarity)  # it was seen from a side that is another one now
    return replace(landmark_map, points=points, cov=cov, polarity=polarity, quality=None)


def thinned(landmark_map: LandmarkMap, seed: int) -> LandmarkMap:
    """Return the map without 30 % of its landmarks."""
    rng = np.random.default_rng([seed, 12])
    kept = rng.permutation(len(landmark_map))[: round((1 - WORN) * len(landmark_map))]
    return landmark_map.take(np.sort(kept))


def rearranged(landmark_map: LandmarkMap, seed: int) -> LandmarkMap:
    """Return the map with 30 % of its landmarks 0.3 m from where they stand."""
    rng = np.random.default_rng([seed, 13])
    moved = rng.permutation(len(landmark_map))[: round(WORN * len(landmark_map))]
    angle = rng.uniform(-np.pi, np.pi, len(moved))
    points = landmark_map.points.copy()
    points[moved] += MOVED_M * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return replace(landmark_map, points=points)
