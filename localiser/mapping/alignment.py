"""Align two landmark maps with unknown correspondences."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, map_from_robot, wrap_angle
from localiser.landmarks import LandmarkMap

_BIN_M = 0.3  # places of votes for a shift
_MOST_BINS = 2**22  # from which on most are empty, and are not counted
_TURN_STEP_RAD = np.deg2rad(1.5)
_SCALES = np.exp(np.arange(-18, 19) * 0.02)  # 0.70 to 1.43, in steps of 2 %
_MOST_VOTERS, _MOST_VOTERS_OF_SCALE = 200, 60  # landmarks of each map that vote at every turn; with a scale, too
_BEST = 12  # peaks of votes that are looked at closely
_GATES_M = (1.0, 0.6, 0.4)  # before the last one: landmarks match within so much
_ROUNDS = 10
_FEWEST = 3
_SAME_M, _SAME_RAD = 0.3, np.deg2rad(3.0)  # poses nearer than this are one and the same alignment


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """How a second map lies in a first: point = map_from_robot(pose, scale * second point).

    pose: (3,) x, z, heading. pairs: (K, 2) landmarks of the first and the second that are one. residual_m: (K,).
    alternative: matches of the next best alignment that is another one, as a fraction of K; near 1 it is unknown which
    is right.
    """

    pose: Array
    scale: float
    pairs: NDArray[np.int64]
    residual_m: Array
    alternative: float

    def apply(self, points: Array) -> Array:
        """Return points (K, 2) of the second map in the first."""
        return map_from_robot(self.pose, self.scale * points)

    def moved(self, second: LandmarkMap) -> LandmarkMap:
        """Return the second map in the frame of the first; heights are left as they are."""
        turn = map_from_robot(np.array([0.0, 0.0, self.pose[2]]), self.scale * np.eye(2)).T
        return replace(second, points=self.apply(second.points), cov=turn @ second.cov @ turn.T)


def align(first: Array, second: Array, within_m: float, *, similarity: bool = False) -> Alignment:
    """Return how landmarks `second` (B, 2) lie over `first` (A, 2), matched where they are `within_m` of each other.

    Every pair of landmarks votes for a shift, at every turn (and scale, for a `similarity`); the highest peaks are
    refined by least squares over mutual nearest neighbours, and the one that matches most landmarks wins, then the one
    that does so best. Raises ValueError when fewer than three landmarks match.
    """
    found = [_refined(first, second, *peak, within_m, similarity) for peak in _peaks(first, second, similarity)]
    found.sort(key=lambda one: (-len(one.pairs), float(np.square(one.residual_m).sum())))
    if not found or len(found[0].pairs) < _FEWEST:
        raise ValueError(f"expected at least {_FEWEST} landmarks that match within {within_m:g} m, found fewer")
    best = found[0]
    others = (len(one.pairs) for one in found[1:] if not _same(one, best))
    return Alignment(best.pose, best.scale, best.pairs, best.residual_m, max(others, default=0) / len(best.pairs))


def matches(first: Array, second: Array, within_m: float) -> NDArray[np.int64]:
    """Return the pairs (K, 2) of points (A, 2) and (B, 2) that are each other's nearest, and no farther than that."""
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(first).query(second)
    _, back = cKDTree(second).query(first)
    mutual = np.flatnonzero((back[nearest] == np.arange(len(second))) & (distance <= within_m))
    return np.stack([nearest[mutual], mutual], axis=-1).astype(np.int64)


def _peaks(first: Array, second: Array, similarity: bool) -> list[tuple[Array, float]]:
    """Return the poses and scales that most pairs of landmarks vote for."""
    most = _MOST_VOTERS_OF_SCALE if similarity else _MOST_VOTERS
    voters = _thinned(first, most), _thinned(second, most)
    turns = np.arange(-np.pi, np.pi, _TURN_STEP_RAD)
    peaks = [
        (*most_voted(*voters, turn, scale), turn, scale)
        for scale in (_SCALES if similarity else (1.0,))
        for turn in turns
    ]
    peaks.sort(key=lambda peak: -peak[0])
    chosen: list[tuple[Array, float]] = []
    for _, shift, turn, scale in peaks:
        pose = np.array([*shift, turn])
        if all(_far(pose, other) or abs(scale / size - 1) > 0.05 for other, size in chosen):
            chosen.append((pose, float(scale)))
        if len(chosen) == _BEST:
            break
    return chosen


def _thinned(points: Array, most: int) -> Array:
    """Return at most so many of the points, evenly from one end to the other."""
    if len(points) <= most:
        return points
    order = np.lexsort((points[:, 1], points[:, 0]))
    return np.asarray(points[order[np.linspace(0, len(points) - 1, most).astype(int)]])


def most_voted(
    first: Array, second: Array, turn: float, scale: float, most_bins: int = _MOST_BINS
) -> tuple[int, Array]:
    """Return the number of votes for the best shift (m) of `second` (B, 2) over `first` (A, 2), and that shift (2,).

    turn: rad. most_bins: from so many places on only those are counted that have votes.
    """
    turned = map_from_robot(np.array([0.0, 0.0, turn]), scale * second)
    shifts = (first[:, None] - turned[None]).reshape(-1, 2)
    low = shifts.min(axis=0)
    cell = ((shifts - low) / _BIN_M).astype(np.int64)
    size = cell.max(axis=0) + 2
    if float(size[0]) * float(size[1]) > most_bins:
        most, place = _most_voted_of_few(cell, int(size[1]))
        return most, low + _BIN_M * (place + 1.0)
    votes = np.bincount(cell[:, 0] * size[1] + cell[:, 1], minlength=int(size[0] * size[1])).reshape(size)
    # A peak on the border of two bins votes in both.
    around = votes[:-1, :-1] + votes[1:, :-1] + votes[:-1, 1:] + votes[1:, 1:]
    row, column = np.unravel_index(int(around.argmax()), around.shape)
    return int(around[row, column]), low + _BIN_M * np.array([row + 1.0, column + 1.0])


def _most_voted_of_few(cell: NDArray[np.int64], columns: int) -> tuple[int, Array]:
    """Return the most votes and their place (2,), as `most_voted` finds them, of cells (S, 2) that lie far apart."""
    around = np.concatenate([cell - step for step in ([0, 0], [0, 1], [1, 0], [1, 1])])
    around = around[(around >= 0).all(axis=1)]
    key, count = np.unique(around[:, 0] * columns + around[:, 1], return_counts=True)
    best = int(count.argmax())
    return int(count[best]), np.array(divmod(int(key[best]), columns), dtype=np.float64)


def _refined(first: Array, second: Array, pose: Array, scale: float, within_m: float, similarity: bool) -> Alignment:
    pairs = np.zeros((0, 2), dtype=np.int64)
    for gate in (*(gate for gate in _GATES_M if gate > within_m), within_m):
        for _ in range(_ROUNDS):
            found = matches(first, map_from_robot(pose, scale * second), gate)
            if len(found) < _FEWEST:
                break
            pose, scale = fitted_motion(first[found[:, 0]], second[found[:, 1]], similarity=similarity)
            if np.array_equal(found, pairs):
                break
            pairs = found
    placed = map_from_robot(pose, scale * second)
    pairs = matches(first, placed, within_m)
    residual = np.hypot(*(placed[pairs[:, 1]] - first[pairs[:, 0]]).T)
    return Alignment(pose, scale, pairs, residual, 0.0)


def fitted_motion(first: Array, second: Array, *, similarity: bool = False) -> tuple[Array, float]:
    """Return the pose (3,) and scale that lay points `second` (K, 2) over `first` (K, 2) best [Umeyama 1991]."""
    middle, other = first.mean(axis=0), second.mean(axis=0)
    a, b = first - middle, second - other
    # Heading turns x towards -z: the angle of (x, -z) is the usual one.
    cos, sin = (a * b).sum(), (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    heading = float(np.arctan2(sin, cos))
    scale = float(np.hypot(cos, sin) / np.square(b).sum()) if similarity and np.square(b).sum() > 0 else 1.0
    turned = map_from_robot(np.array([0.0, 0.0, heading]), scale * other)
    return np.array([*(middle - turned), heading]), scale


def _same(one: Alignment, other: Alignment) -> bool:
    return not _far(one.pose, other.pose) and abs(one.scale / other.scale - 1) < 0.05


def _far(pose: Array, other: Array) -> bool:
    apart = np.hypot(*(pose - other)[:2]) > _SAME_M
    return bool(apart or abs(wrap_angle(pose[2] - other[2])) > _SAME_RAD)
