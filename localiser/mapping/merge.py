"""Put maps together: landmarks that are one are fused, the others are kept."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.landmarks import LandmarkMap, Quality
from localiser.mapping.alignment import matches

Mask = NDArray[np.bool_]

_CHI2_99 = 9.21  # squared Mahalanobis distance that holds 99 % of a Gaussian in the plane


def joined_maps(first: LandmarkMap, second: LandmarkMap) -> LandmarkMap:
    """Return the landmarks of both maps, those of the second with new ids where the first has them already."""
    taken = {str(name) for name in first.ids}
    number = 1 + max((name for name in (*first.ids, *second.ids) if isinstance(name, int)), default=-1)
    ids: list[int | str] = []
    for name in second.ids:
        ids.append(number if str(name) in taken else name)
        number += ids[-1] == number
        taken.add(str(ids[-1]))
    columns: dict[str, Any] = {
        column: np.concatenate([getattr(first, column), getattr(second, column)])
        for column in ("points", "cov", "bottom_m", "top_m", "polarity")
    }
    return replace(
        first,
        ids=(*first.ids, *ids),
        source=(*first.source, *second.source),
        extra=(*_extra(first), *_extra(second)),
        quality=_joined_quality(first, second),
        **columns,
    )


def fused(first: LandmarkMap, second: LandmarkMap, pairs: NDArray[np.int64]) -> LandmarkMap:
    """Return both maps with the landmarks `pairs` (K, 2) as one: place by their covariances, the rest by the second.

    The first's ids stay. Where a covariance is not known, the other's place counts alone; where neither is, the
    second's.
    """
    one, other = pairs.T
    points, cov = fused_places(first.points[one], first.cov[one], second.points[other], second.cov[other])
    seen = second.take(other)
    whole = joined_maps(first, second.take(np.setdiff1d(np.arange(len(second)), other)))
    columns: dict[str, Any] = {
        name: getattr(whole, name).copy() for name in ("points", "cov", "bottom_m", "top_m", "polarity")
    }
    columns["points"][one], columns["cov"][one] = points, cov
    for name in ("bottom_m", "top_m"):
        columns[name][one] = np.where(np.isnan(getattr(seen, name)), columns[name][one], getattr(seen, name))
    columns["polarity"][one] = np.where(seen.polarity == 0, columns["polarity"][one], seen.polarity)
    source = list(whole.source)
    for index, name in zip(one, seen.source, strict=True):
        source[index] = f"{source[index]}; {name}".strip("; ")
    quality = whole.quality
    if quality is not None and second.quality is not None:
        quality = _with_rows(quality, one, second.quality.take(other))
    return replace(whole, source=tuple(source), quality=quality, **columns)


def fused_places(first: Array, cov: Array, second: Array, other_cov: Array) -> tuple[Array, Array]:
    """Return points (K, 2) and covariances (K, 2, 2) by the information of both; see `fused` for what is unknown."""
    known, other_known = _is_known(cov), _is_known(other_cov)
    both = known & other_known
    points = np.where((known & ~other_known)[:, None], first, second)
    result = np.where((known & ~other_known)[:, None, None], cov, other_cov)
    gain = cov[both] @ np.linalg.inv(cov[both] + other_cov[both])
    points[both] = first[both] + np.einsum("kij,kj->ki", gain, second[both] - first[both])
    result[both] = cov[both] - gain @ cov[both]
    return points, result


def same_in_both(first: LandmarkMap, second: LandmarkMap, within_m: float) -> NDArray[np.int64]:
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


def _extra(landmark_map: LandmarkMap) -> tuple[dict[str, object], ...]:
    return landmark_map.extra or ({},) * len(landmark_map)


def _joined_quality(first: LandmarkMap, second: LandmarkMap) -> Quality | None:
    if first.quality is None and second.quality is None:
        return None
    one = first.quality or Quality.unknown(len(first))
    other = second.quality or Quality.unknown(len(second))
    width = max(one.profile.shape[1], other.profile.shape[1])
    return Quality(
        np.concatenate([one.sightings, other.sightings]),
        np.concatenate([one.parallax_rad, other.parallax_rad]),
        np.concatenate([one.existence, other.existence]),
        np.concatenate([_widened(one.profile, width), _widened(other.profile, width)]),
    )


def _widened(profile: Array, width: int) -> Array:
    """Return profiles (L, P) as (L, width); those of another width are not known."""
    return profile if profile.shape[1] == width else np.full((len(profile), width), np.nan)


def _with_rows(quality: Quality, rows: NDArray[np.int64], new: Quality) -> Quality:
    """Return the quality with what `new` (K) knows at `rows` (K,)."""
    columns = {}
    for name in ("sightings", "parallax_rad", "existence"):
        column, values = getattr(quality, name).copy(), getattr(new, name)
        column[rows] = np.where(np.isnan(values), column[rows], values)
        columns[name] = column
    profile = quality.profile.copy()
    if new.profile.shape[1] == profile.shape[1]:
        profile[rows] = np.where(np.isnan(new.profile), profile[rows], new.profile)
    return Quality(**columns, profile=profile)
