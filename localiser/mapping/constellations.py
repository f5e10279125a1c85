"""Loop closure after large drift: which group of landmarks, as a whole, has been seen before.

Single landmarks are told apart by looks alone once drift exceeds their spacing. But drift moves all that is seen at one
time together: a few landmarks keep their distances from each other. So a group is moved rigidly to where most of it
falls on older landmarks that look alike, and that must explain clearly more of it than any other move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, wrap_angle
from localiser.mapping.landmarks import Built
from localiser.mapping.likeness import log_likeness
from localiser.mapping.sightings import Index

_WINDOW, _STEP = 24, 8  # frames whose landmarks make a group, and how far apart groups begin
_OLDER = 30  # frames that must have passed since an older landmark was last seen
_FARTHEST_M, _TURN_MOST_RAD = 4.0, np.deg2rad(20.0)  # drift beyond this is not looked for
_CLOSE_M = 0.08  # so near a moved landmark must fall to the older one
_BASELINE_M = 0.7  # two landmarks nearer to each other say little of a turn
_FEWEST, _SHARE, _CLEARLY = 5, 0.5, 1.4
_OTHER_M = 0.4  # moves that differ by more are other moves


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """Pairs (P) of a landmark of the group and an older one that may be the same."""

    new: Index
    old: Index


def seen_before(points: Array, built: Built, seen: NDArray[np.bool_]) -> Index:
    """Return for each landmark (L) the number of the older one that it is; its own where there is none.

    points: (L, 2) as smoothed. seen: (T, L) which frames show which. Groups are taken in the order of time.
    """
    number = np.arange(len(points))
    frames = len(seen)
    first, last = seen.argmax(axis=0), frames - 1 - seen[::-1].argmax(axis=0)
    known = built.parallax >= np.deg2rad(3.0)
    alike = log_likeness(built.side, built.polarity, built.side, built.polarity) >= 0
    for start in range(0, frames, _STEP):
        group = np.flatnonzero(known & seen[start : start + _WINDOW].any(axis=0) & (first >= start - _OLDER))
        older = np.flatnonzero(known & (last < start - _OLDER))
        pairs = _same_by_move(points, group, older, alike)
        taken = number != np.arange(len(points))
        for new, old in zip(pairs.new, pairs.old, strict=True):
            if not (taken[new] or taken[old]) and number[old] == old:
                number[new] = old
    return number


def _same_by_move(points: Array, group: Index, older: Index, alike: NDArray[np.bool_]) -> _Candidates:
    """Return the pairs that the best rigid move of a group explains; none where no move is clearly the best."""
    nothing = _Candidates(group[:0], older[:0])
    if len(group) < _FEWEST or len(older) < _FEWEST:
        return nothing
    apart = np.linalg.norm(points[group][:, None] - points[older][None], axis=-1)
    row, column = np.nonzero((apart < _FARTHEST_M) & alike[np.ix_(group, older)])
    moves = _moves(points[group], points[older], row, column)
    if len(moves) == 0:
        return nothing
    count = np.array([_explained(points, group, older, alike, move)[0].size for move in moves])
    best = int(count.argmax())
    middle = points[group].mean(axis=0)
    away = np.linalg.norm(_moved(middle, moves) - _moved(middle, moves[best : best + 1]), axis=-1)
    rival = count[away > _OTHER_M].max(initial=0)
    if count[best] < max(_FEWEST, _SHARE * len(group), _CLEARLY * rival):
        return nothing
    new, old = _explained(points, group, older, alike, moves[best])
    return _Candidates(group[new], older[old])


def _moves(new: Array, old: Array, row: Index, column: Index) -> Array:
    """Return the rigid moves (M, 3), x, z and turn, that take two landmarks of the group onto two older ones."""
    one, other = np.triu_indices(len(row), k=1)
    differs = (row[one] != row[other]) & (column[one] != column[other])
    one, other = one[differs], other[differs]
    baseline, older = new[row[other]] - new[row[one]], old[column[other]] - old[column[one]]
    length, same = np.linalg.norm(baseline, axis=1), np.linalg.norm(older, axis=1)
    turn = wrap_angle(np.arctan2(older[:, 1], older[:, 0]) - np.arctan2(baseline[:, 1], baseline[:, 0]))
    fit = (length > _BASELINE_M) & (np.abs(length - same) < _CLOSE_M) & (np.abs(turn) < _TURN_MOST_RAD)
    index = np.flatnonzero(fit)[:: max(1, int(fit.sum()) // 1500)]
    turn = turn[index]
    middle = (new[row[one[index]]] + new[row[other[index]]]) / 2
    target = (old[column[one[index]]] + old[column[other[index]]]) / 2
    cos, sin = np.cos(turn), np.sin(turn)
    shift = target - np.stack(
        [cos * middle[:, 0] - sin * middle[:, 1], sin * middle[:, 0] + cos * middle[:, 1]], axis=-1
    )
    return np.column_stack([shift, turn])


def _moved(points: Array, moves: Array) -> Array:
    """Return points (..., 2) moved by each of the moves (M, 3)."""
    cos, sin = np.cos(moves[:, 2]), np.sin(moves[:, 2])
    x, z = points[..., 0], points[..., 1]
    return np.stack([cos * x - sin * z, sin * x + cos * z], axis=-1) + moves[:, :2]


def _explained(points: Array, group: Index, older: Index, alike: NDArray[np.bool_], move: Array) -> tuple[Index, Index]:
    """Return which of the group (A,) a move brings onto which older landmarks (A,), each nearest to the other."""
    cos, sin = np.cos(move[2]), np.sin(move[2])
    at = points[group] @ np.array([[cos, sin], [-sin, cos]]) + move[:2]
    apart = np.linalg.norm(at[:, None] - points[older][None], axis=-1)
    apart = np.where(alike[np.ix_(group, older)], apart, np.inf)
    nearest, back = apart.argmin(axis=1), apart.argmin(axis=0)
    index = np.arange(len(group))
    mutual = (back[nearest] == index) & (apart[index, nearest] < _CLOSE_M)
    return index[mutual], nearest[mutual]
