"""Merge maps: landmarks that are the same are fused, the others are kept; of two maps, or within one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, Quality
from localiser.mapping.alignment import matches
from localiser.mapping.sightings import Index

Mask = NDArray[np.bool_]

_PLAIN = ("points", "cov", "bottom_m", "top_m", "polarity")
_QUALITY = ("sightings", "parallax_rad", "existence")
_CHI2_99 = 9.21  # squared Mahalanobis distance that holds 99 % of a Gaussian in the plane
TWICE_M = 0.02
"""Landmarks nearer to each other are one to any camera here."""
_NEAR_M = 0.1  # farther from each other, two uncertain landmarks may well be two
_SHARED_M = 0.016  # sigma of places that is the most which a build adds to that of every landmark


def join_maps(first: LandmarkMap, second: LandmarkMap) -> LandmarkMap:
    """Return the landmarks of both maps, those of the second with new ids where the first has them already."""
    taken = {str(name) for name in first.ids}
    number = 1 + max((name for name in (*first.ids, *second.ids) if isinstance(name, int)), default=-1)
    ids: list[int | str] = []
    for name in second.ids:
        ids.append(number if str(name) in taken else name)
        number += ids[-1] == number
        taken.add(str(ids[-1]))
    extra = (*(first.extra or ({},) * len(first)), *(second.extra or ({},) * len(second)))
    whole = replace(first, ids=(*first.ids, *ids), source=(*first.source, *second.source), extra=extra)
    width = max(one.quality.profile.shape[1] if one.quality else 0 for one in (first, second))
    pairs = zip(*(_columns(one, width).items() for one in (first, second)), strict=True)
    columns = {name: np.concatenate([one, other]) for (name, one), (_, other) in pairs}
    return _with_columns(whole, columns, has_quality=first.quality is not None or second.quality is not None)


def fuse_maps(first: LandmarkMap, second: LandmarkMap, pairs: NDArray[np.int64]) -> LandmarkMap:
    """Return both maps with the landmarks `pairs` (K, 2) as one: place by their covariances, the rest by the second.

    The first's ids stay. Where a covariance is not known, the other's place counts alone; where neither is, the
    second's.
    """
    one, other = pairs.T
    seen = second.take(other)
    whole = join_maps(first, second.take(np.setdiff1d(np.arange(len(second)), other)))
    columns = _columns(whole, whole.quality.profile.shape[1] if whole.quality else 0)
    for name, values in _columns(seen, columns["profile"].shape[1]).items():
        column = columns[name] = columns[name].copy()
        unknown = values == 0 if name == "polarity" else np.isnan(values)
        column[one] = np.where(unknown, column[one], values)
    columns["points"][one], columns["cov"][one] = fused_places(first.points[one], first.cov[one], seen.points, seen.cov)
    source = list(whole.source)
    for index, name in zip(one, seen.source, strict=True):
        source[index] = f"{source[index]}; {name}".strip("; ")
    return _with_columns(replace(whole, source=tuple(source)), columns, has_quality=whole.quality is not None)


def _columns(one: LandmarkMap, width: int) -> dict[str, Any]:
    """Return what is known of each landmark (L), profiles as (L, width); those of another width are not known."""
    quality = one.quality or Quality.unknown(len(one))
    profile = quality.profile if quality.profile.shape[1] == width else np.full((len(one), width), np.nan)
    return {name: getattr(quality if name in _QUALITY else one, name) for name in _PLAIN + _QUALITY} | {
        "profile": profile
    }


def _with_columns(one: LandmarkMap, columns: dict[str, Any], *, has_quality: bool) -> LandmarkMap:
    """Return a map with other columns, and a quality only where one of the maps that it was made of has one."""
    plain = {name: columns.pop(name) for name in _PLAIN}
    return replace(one, quality=Quality(**columns) if has_quality else None, **plain)


def fused_places(first: Array, cov: Array, second: Array, other_cov: Array) -> tuple[Array, Array]:
    """Return points (K, 2) and covariances (K, 2, 2) by the information of both; see `fuse_maps` for what is unknown."""
    known, other_known = _is_known(cov), _is_known(other_cov)
    both = known & other_known
    points = np.where((known & ~other_known)[:, None], first, second)
    result = np.where((known & ~other_known)[:, None, None], cov, other_cov)
    gain = cov[both] @ np.linalg.inv(cov[both] + other_cov[both])
    points[both] = first[both] + np.einsum("kij,kj->ki", gain, second[both] - first[both])
    result[both] = cov[both] - gain @ cov[both]
    return points, result


def common_landmarks(first: LandmarkMap, second: LandmarkMap, within_m: float) -> NDArray[np.int64]:
    """Return the landmarks (K, 2) of two maps in one frame that are one.

    They are each other's nearest, within `within_m`, and do not contradict each other.
    """
    pairs = matches(first.points, second.points, within_m)
    return pairs[agreeing(first, second, pairs, within_m)]


def agreeing(first: LandmarkMap, second: LandmarkMap, pairs: NDArray[np.int64], least_m: float) -> Mask:
    """Return which pairs (K, 2) differ by no more than their covariances say, or than `least_m`, and by polarity."""
    one, other = pairs.T
    offset = second.points[other] - first.points[one]
    cov = np.nan_to_num(first.cov[one]) + np.nan_to_num(second.cov[other]) + least_m**2 / _CHI2_99 * np.eye(2)
    chi2 = np.einsum("ki,kij,kj->k", offset, np.linalg.inv(cov), offset)
    return np.asarray((chi2 <= _CHI2_99) & (first.polarity[one] * second.polarity[other] >= 0))


def _is_known(cov: Array) -> Mask:
    return np.asarray(np.isfinite(cov).all(axis=(1, 2)))


# -- within one map ----------------------------------------------------------------------------------------------------


def duplicates(landmark_map: LandmarkMap) -> Index:
    """Return the pairs (K, 2) of landmarks that are probably one: as near as two can be told apart, and alike."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(landmark_map.points).query_pairs(_NEAR_M, output_type="ndarray").astype(np.int64).reshape(-1, 2)
    one, other = pairs.T
    apart = np.hypot(*(landmark_map.points[one] - landmark_map.points[other]).T)
    alike = landmark_map.polarity[one] * landmark_map.polarity[other] >= 0
    # A covariance that is not known makes nothing likely.
    own = replace(landmark_map, cov=_own_cov(landmark_map.cov))
    same = agreeing(own, own, pairs, TWICE_M)
    return np.asarray(pairs[alike & ((apart < TWICE_M) | same)])


def _own_cov(cov: Array) -> Array:
    """Return covariances (L, 2, 2) without the errors that images and poses share, up to `_SHARED_M`² across.

    No number of images averages these out (`place_cov`), and they say nothing of whether two neighbours, such as the
    backs of two books, are one. Across the line of sight they are as large as half of all landmarks are certain, and
    they grow along it as the rest of the error does. So a covariance shrinks as a whole.
    """
    known = np.isfinite(cov).all(axis=(1, 2)) & (np.trace(cov, axis1=1, axis2=2) > 0)
    if not known.any():
        return cov
    across = np.maximum(np.linalg.eigvalsh(cov[known])[:, 0], 1e-30)
    shared = np.clip(np.median(across), 0.0, _SHARED_M**2)
    own = cov.copy()
    own[known] *= np.maximum(1.0 - shared / across, 0.0)[:, None, None]
    return own


def merge_duplicates(landmark_map: LandmarkMap) -> tuple[LandmarkMap, list[tuple[int | str, int | str]]]:
    """Return the map with its duplicates merged, and the ids of each pair: which stayed, and which went into it.

    The nearest pairs come first, until none is left. Of a pair that landmark stays which more images show; see
    `_merge_pairs`.
    """
    gone: list[tuple[int | str, int | str]] = []
    while len(pairs := _disjoint(landmark_map)):
        gone += [(landmark_map.ids[kept], landmark_map.ids[other]) for kept, other in pairs]
        landmark_map = _merge_pairs(landmark_map, pairs)
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


def _merge_pairs(landmark_map: LandmarkMap, pairs: Index) -> LandmarkMap:
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
