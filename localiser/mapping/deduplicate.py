"""Merge landmarks of one map that are probably one: those that the check of a map lists."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from localiser.landmarks import LandmarkMap
from localiser.mapping.check import duplicates
from localiser.mapping.merge import fused_places
from localiser.mapping.sightings import Index


def deduplicated(landmark_map: LandmarkMap) -> tuple[LandmarkMap, list[tuple[int | str, int | str]]]:
    """Return the map with its duplicates merged, and the ids of each pair: which stayed, and which went into it.

    The nearest pairs come first, until none is left. Of a pair that landmark stays which more images show; see
    `_merged`.
    """
    gone: list[tuple[int | str, int | str]] = []
    while len(pairs := _disjoint(landmark_map)):
        gone += [(landmark_map.ids[kept], landmark_map.ids[other]) for kept, other in pairs]
        landmark_map = _merged(landmark_map, pairs)
    return landmark_map, gone


def _disjoint(landmark_map: LandmarkMap) -> Index:
    """Return duplicates (K, 2), each landmark once, the nearest first; which of two stays is the first of them."""
    pairs = duplicates(landmark_map)
    apart = np.hypot(*(landmark_map.points[pairs[:, 0]] - landmark_map.points[pairs[:, 1]]).T)
    shown = np.zeros(len(landmark_map)) if landmark_map.quality is None else landmark_map.quality.sightings
    taken: set[int] = set()
    chosen = []
    for one, other in pairs[np.argsort(apart, kind="stable")].tolist():
        if taken.isdisjoint((one, other)):
            taken |= {one, other}
            chosen.append((one, other) if not shown[other] > shown[one] else (other, one))
    return np.array(chosen, dtype=np.int64).reshape(-1, 2)


def _merged(landmark_map: LandmarkMap, pairs: Index) -> LandmarkMap:
    """Return the map with the second of each pair (K, 2) merged into the first.

    Places by their covariances, the middle where none is known. Heights reach as far as either did, and an end is
    unknown where it is so for either. Sightings add up; existence and parallax are the greater ones.
    """
    one, other = pairs.T
    points, cov = landmark_map.points.copy(), landmark_map.cov.copy()
    points[one], cov[one] = fused_places(points[one], cov[one], points[other], cov[other])
    unknown = ~np.isfinite(cov[one]).all(axis=(1, 2))
    points[one[unknown]] = landmark_map.points[pairs[unknown]].mean(axis=1)
    bottom, top, polarity = landmark_map.bottom_m.copy(), landmark_map.top_m.copy(), landmark_map.polarity.copy()
    bottom[one], top[one] = np.minimum(bottom[one], bottom[other]), np.maximum(top[one], top[other])
    polarity[one] = np.where(polarity[one] == 0, polarity[other], polarity[one])
    quality = landmark_map.quality
    if quality is not None:
        sightings, parallax, existence = (
            column.copy() for column in (quality.sightings, quality.parallax_rad, quality.existence)
        )
        sightings[one] = np.nansum([sightings[one], sightings[other]], axis=0)
        parallax[one] = np.fmax(parallax[one], parallax[other])
        existence[one] = np.fmax(existence[one], existence[other])
        quality = replace(quality, sightings=sightings, parallax_rad=parallax, existence=existence)
    whole = replace(
        landmark_map, points=points, cov=cov, bottom_m=bottom, top_m=top, polarity=polarity, quality=quality
    )
    return whole.take(np.setdiff1d(np.arange(len(whole)), other))
