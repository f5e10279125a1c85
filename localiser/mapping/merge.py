"""Lay maps over each other with unknown correspondences, and merge them: what is the same is fused, the rest kept."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, map_from_robot, wrap_angle
from localiser.landmarks import LandmarkMap, Quality
from localiser.mapping.recorded import DRIVE
from localiser.mapping.sightings import Index

# -- alignment --------------------------------------------------------------------------------------------------------

_BIN_M = 0.3  # places of votes for a shift
_MOST_BINS = 2**22  # from which on most are empty, and are not counted
_TURN_STEP_RAD = np.deg2rad(1.5)
_MOST_VOTERS = 200  # landmarks of each map that vote at every turn
_BEST = 12  # peaks of votes that are looked at closely
_GATES_M = (1.0, 0.6, 0.4)  # before the last one: landmarks match within so much
_ROUNDS = 10
_FEWEST = 3
_SAME_M, _SAME_RAD = 0.3, np.deg2rad(3.0)  # poses nearer than this are one and the same alignment


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """How a second map lies in a first: point = map_from_robot(pose, second point).

    pose: (3,) x, z, heading. pairs: (K, 2) landmarks of the first and the second that are one. residual_m: (K,).
    alternative: matches of the next best alignment that is another one, as a fraction of K; near 1 it is unknown which
    is right.
    """

    pose: Array
    pairs: NDArray[np.int64]
    residual_m: Array
    alternative: float

    def moved(self, second: LandmarkMap) -> LandmarkMap:
        """Return the second map in the frame of the first; heights are left as they are."""
        turn = map_from_robot(np.array([0.0, 0.0, self.pose[2]]), np.eye(2)).T
        header = {name: value for name, value in second.header.items() if name != DRIVE}  # it began in another frame
        return replace(
            second, points=map_from_robot(self.pose, second.points), cov=turn @ second.cov @ turn.T, header=header
        )


def align(first: Array, second: Array, within_m: float) -> Alignment:
    """Return how landmarks `second` (B, 2) lie over `first` (A, 2), matched where they are `within_m` of each other.

    Every pair of landmarks votes for a shift, at every turn; the highest peaks are refined by least squares over mutual
    nearest neighbours, and the one that matches most landmarks wins, then the one that does so best. Raises ValueError
    when fewer than three landmarks match.
    """
    found = [_refine(first, second, pose, within_m) for pose in _peaks(first, second)]
    found.sort(key=lambda one: (-len(one.pairs), float(np.square(one.residual_m).sum())))
    if not found or len(found[0].pairs) < _FEWEST:
        raise ValueError(f"expected at least {_FEWEST} landmarks that match within {within_m:g} m, found fewer")
    best = found[0]
    others = (len(one.pairs) for one in found[1:] if _far(one.pose, best.pose))
    return Alignment(best.pose, best.pairs, best.residual_m, max(others, default=0) / len(best.pairs))


def matches(first: Array, second: Array, within_m: float) -> NDArray[np.int64]:
    """Return the pairs (K, 2) of points (A, 2) and (B, 2) that are each other's nearest, and no farther than that."""
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(first).query(second)
    _, back = cKDTree(second).query(first)
    mutual = np.flatnonzero((back[nearest] == np.arange(len(second))) & (distance <= within_m))
    return np.stack([nearest[mutual], mutual], axis=-1).astype(np.int64)


def _peaks(first: Array, second: Array) -> list[Array]:
    """Return the poses (3,) that most pairs of landmarks vote for."""
    voters = _thinned(first, _MOST_VOTERS), _thinned(second, _MOST_VOTERS)
    peaks = [(*vote_for_shift(*voters, turn), turn) for turn in np.arange(-np.pi, np.pi, _TURN_STEP_RAD)]
    peaks.sort(key=lambda peak: -peak[0])
    chosen: list[Array] = []
    for _, shift, turn in peaks:
        pose = np.array([*shift, turn])
        if all(_far(pose, other) for other in chosen):
            chosen.append(pose)
        if len(chosen) == _BEST:
            break
    return chosen


def _thinned(points: Array, most: int) -> Array:
    """Return at most so many of the points, evenly from one end to the other."""
    if len(points) <= most:
        return points
    order = np.lexsort((points[:, 1], points[:, 0]))
    return np.asarray(points[order[np.linspace(0, len(points) - 1, most).astype(int)]])


def vote_for_shift(first: Array, second: Array, turn: float, most_bins: int = _MOST_BINS) -> tuple[int, Array]:
    """Return the number of votes for the best shift (m) of `second` (B, 2) over `first` (A, 2), and that shift (2,).

    turn: rad. most_bins: from so many places on only those are counted that have votes.
    """
    turned = map_from_robot(np.array([0.0, 0.0, turn]), second)
    shifts = (first[:, None] - turned[None]).reshape(-1, 2)
    low = shifts.min(axis=0)
    cell = ((shifts - low) / _BIN_M).astype(np.int64)
    size = cell.max(axis=0) + 2
    if float(size[0]) * float(size[1]) > most_bins:
        around = np.concatenate([cell - step for step in ([0, 0], [0, 1], [1, 0], [1, 1])])
        around = around[(around >= 0).all(axis=1)]
        key, count = np.unique(around[:, 0] * size[1] + around[:, 1], return_counts=True)
        best = int(count.argmax())
        return int(count[best]), low + _BIN_M * (np.array(divmod(int(key[best]), int(size[1]))) + 1.0)
    votes = np.bincount(cell[:, 0] * size[1] + cell[:, 1], minlength=int(size[0] * size[1])).reshape(size)
    # A peak on the border of two bins votes in both.
    around = votes[:-1, :-1] + votes[1:, :-1] + votes[:-1, 1:] + votes[1:, 1:]
    row, column = np.unravel_index(int(around.argmax()), around.shape)
    return int(around[row, column]), low + _BIN_M * np.array([row + 1.0, column + 1.0])


def _refine(first: Array, second: Array, pose: Array, within_m: float) -> Alignment:
    pairs = np.zeros((0, 2), dtype=np.int64)
    for gate in (*(gate for gate in _GATES_M if gate > within_m), within_m):
        for _ in range(_ROUNDS):
            found = matches(first, map_from_robot(pose, second), gate)
            if len(found) < _FEWEST:
                break
            pose = best_motion(first[found[:, 0]], second[found[:, 1]])
            if np.array_equal(found, pairs):
                break
            pairs = found
    placed = map_from_robot(pose, second)
    pairs = matches(first, placed, within_m)
    residual = np.hypot(*(placed[pairs[:, 1]] - first[pairs[:, 0]]).T)
    return Alignment(pose, pairs, residual, 0.0)


def best_motion(first: Array, second: Array) -> Array:
    """Return the pose (3,) that lays points `second` (K, 2) over `first` (K, 2) best [Umeyama 1991]."""
    middle, other = first.mean(axis=0), second.mean(axis=0)
    a, b = first - middle, second - other
    # Heading turns x towards -z: the angle of (x, -z) is the usual one.
    heading = float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))
    return np.array([*(middle - map_from_robot(np.array([0.0, 0.0, heading]), other)), heading])


def _far(pose: Array, other: Array) -> bool:
    apart = np.hypot(*(pose - other)[:2]) > _SAME_M
    return bool(apart or abs(wrap_angle(pose[2] - other[2])) > _SAME_RAD)


# -- merging ----------------------------------------------------------------------------------------------------------

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
    both = (first, second)
    columns: dict[str, Any] = {name: np.concatenate([getattr(one, name) for one in both]) for name in _PLAIN}
    known = [one.quality or Quality.unknown(len(one)) for one in both]
    quality = Quality(*(np.concatenate([getattr(one, name) for one in known]) for name in _QUALITY))
    columns["quality"] = None if first.quality is None and second.quality is None else quality
    return replace(first, ids=(*first.ids, *ids), source=(*first.source, *second.source), extra=extra, **columns)


def fuse_maps(first: LandmarkMap, second: LandmarkMap, pairs: NDArray[np.int64]) -> LandmarkMap:
    """Return both maps with the landmarks `pairs` (K, 2) as one: place by their covariances, the rest by the second.

    The first's ids stay. Where a covariance is not known, the other's place counts alone; where neither is, the
    second's.
    """
    one, other = pairs.T
    seen = second.take(other)
    whole = join_maps(first, second.take(np.setdiff1d(np.arange(len(second)), other)))

    def newer(name: str, before: Any, now: Any) -> Array:
        column, values = getattr(before, name).copy(), getattr(now, name)
        unknown = values == 0 if name == "polarity" else np.isnan(values)
        column[one] = np.where(unknown, column[one], values)
        return np.asarray(column)

    columns: dict[str, Any] = {name: newer(name, whole, seen) for name in _PLAIN}
    crossed = columns["bottom_m"] > columns["top_m"]  # ends of two maps, which are not of one edge
    columns["bottom_m"][crossed] = columns["top_m"][crossed] = np.nan
    columns["points"][one], columns["cov"][one] = fuse_places(first.points[one], first.cov[one], seen.points, seen.cov)
    if whole.quality is not None:
        now = seen.quality or Quality.unknown(len(seen))
        columns["quality"] = Quality(*(newer(name, whole.quality, now) for name in _QUALITY))
    source = list(whole.source)
    for index, name in zip(one, seen.source, strict=True):
        source[index] = f"{source[index]}; {name}".strip("; ")
    return replace(whole, source=tuple(source), **columns)


def fuse_places(first: Array, cov: Array, second: Array, other_cov: Array) -> tuple[Array, Array]:
    """Return points (K, 2) and covariances (K, 2, 2) by the information of both; unknown: see `fuse_maps`."""
    known, other_known = _is_known(cov), _is_known(other_cov)
    both = known & other_known
    points = np.where((known & ~other_known)[:, None], first, second)
    result = np.where((known & ~other_known)[:, None, None], cov, other_cov)
    # Places may be known exactly, also in one direction.
    gain = cov[both] @ np.linalg.pinv(cov[both] + other_cov[both], rcond=1e-12, hermitian=True)
    points[both] = first[both] + np.einsum("kij,kj->ki", gain, second[both] - first[both])
    fused = gain @ other_cov[both]
    result[both] = np.where(np.eye(2) > 0, np.maximum(fused, 0.0), fused)  # no variance is negative by rounding
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

    The nearest pairs come first, until none is left. Of a pair that landmark stays which more images show, and its
    place is that of both by their covariances.
    """
    gone: list[tuple[int | str, int | str]] = []
    while len(pairs := duplicates(landmark_map)):
        apart = np.hypot(*(landmark_map.points[pairs[:, 0]] - landmark_map.points[pairs[:, 1]]).T)
        shown = np.zeros(len(landmark_map)) if landmark_map.quality is None else landmark_map.quality.sightings
        taken: set[int] = set()
        chosen = []
        for first, second in pairs[np.argsort(apart, kind="stable")].tolist():
            if taken.isdisjoint((first, second)):
                taken |= {first, second}
                chosen.append((first, second) if not shown[second] > shown[first] else (second, first))
        pairs = np.array(chosen, dtype=np.int64)
        one, other = pairs.T
        gone += [(landmark_map.ids[i], landmark_map.ids[j]) for i, j in pairs]
        points, cov = landmark_map.points.copy(), landmark_map.cov.copy()
        points[one], cov[one] = fuse_places(points[other], cov[other], points[one], cov[one])
        landmark_map = replace(landmark_map, points=points, cov=cov)
        landmark_map = landmark_map.take(np.setdiff1d(np.arange(len(landmark_map)), other))
    return landmark_map, gone
