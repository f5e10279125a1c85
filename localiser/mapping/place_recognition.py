"""Place recognition: after large drift, find which group of landmarks has been seen before, as a whole.

Drift moves everything that is seen at one time together, so the distances within a group of landmarks are kept. A group
is moved rigidly to where most of it falls on older landmarks that look alike. This move must explain clearly more of
the group than any other move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.geometry import Array, wrap_angle
from localiser.geometry.compiled import compiled
from localiser.mapping.landmarks import Built
from localiser.mapping.merge import best_motion
from localiser.mapping.sightings import Index
from localiser.mapping.tracks import looks_alike

_WINDOW, _STEP = 24, 8  # frames whose landmarks make a group, and how far apart groups begin
_OLDER = 30  # frames that must have passed since an older landmark was last seen
_FARTHEST_M, _TURN_MOST_RAD = 4.0, np.deg2rad(20.0)  # drift beyond this is not looked for
_CLOSE_M = 0.08  # so near a moved landmark must fall to the older one
_BASELINE_M = 0.7  # two landmarks nearer to each other say little of a turn
_REFINEMENTS = 3
_MOST_MOVES = 3000  # that are tried for one group
_MOST_OLDER = 300  # landmarks near a group that are looked at, those that most images show
_FEWEST, _SHARE, _CLEARLY = 5, 0.5, 1.4
_OTHER_M = 0.4  # moves that differ by more are other moves


@dataclass(frozen=True, slots=True, eq=False)
class Recognition:
    """Which landmarks are older ones, and how everything moves so that they stand where these do.

    number: (L,) of the older landmark that each one is; its own where there is none. frame, move: (M,), (M, 3) the
    groups that were recognised, by their middle image, and the move of each since the one before.
    """

    number: Index
    frame: Index
    move: Array

    def far(self, points: Array, apart_m: float) -> bool:
        """Return whether a whole group of landmarks (L, 2) stands farther than `apart_m` from what it is.

        Among thousands of images a few landmarks are always taken for others.
        """
        return bool((np.linalg.norm(points - points[self.number], axis=1) > apart_m).sum() >= _FEWEST)

    def moved(self, poses: Array) -> Array:
        """Return poses (T, 3) without the drift that was found, which grew evenly from group to group."""
        moved = poses.copy()
        begin = 0
        for end, (x, z, turn) in zip(self.frame.tolist(), self.move, strict=True):
            share = np.clip((np.arange(begin, len(poses)) - begin) / max(end - begin, 1), 0.0, 1.0)
            late = moved[begin:]
            late[:, :2] += share[:, None] * (_moved(late[:, :2], np.array([[x, z, turn]])) - late[:, :2])
            late[:, 2] = wrap_angle(late[:, 2] - share * turn)  # headings turn the other way round in the plane (x, z)
            begin = end
        return moved


def recognise_groups(points: Array, built: Built, frame: Index) -> Recognition:
    """Return which landmarks (L) are older ones that were seen before.

    points: (L, 2) as smoothed. frame: (K,) of the sightings used, in their order. Groups are taken in that order. A
    move that recognises a group moves all that is seen later, too: only the drift since then is looked for.
    """
    number, landmark, points = np.arange(len(points)), built.of[built.used], points.copy()
    end = int(frame.max(initial=0))
    first, last = np.full(len(points), end), np.zeros(len(points), dtype=np.int64)
    np.minimum.at(first, landmark, frame)
    np.maximum.at(last, landmark, frame)
    known = built.parallax >= np.deg2rad(3.0)
    middle, moves = [], []
    # What has been recognised stands for itself no more: else a third visit would have two places to choose from.
    for start in range(0, end + 1, _STEP):
        within = slice(*np.searchsorted(frame, [start, start + _WINDOW]))
        group = np.unique(landmark[within])
        group = group[known[group] & (first[group] >= start - _OLDER)]
        older = np.flatnonzero(known & (last < start - _OLDER) & (number == np.arange(len(points))))
        move, *pairs = _same_by_move(points, group, older, built)
        for new, old in zip(*pairs, strict=True):
            if number[new] == new and number[old] == old:
                number[new] = old
        if len(pairs[0]):
            later = first >= start - _OLDER
            points[later] = _moved(points[later], move)
            middle.append(min(start + _WINDOW // 2, end))
            moves.append(move[0])
    return Recognition(number, np.array(middle, dtype=np.int64), np.array(moves).reshape(-1, 3))


def _same_by_move(points: Array, group: Index, older: Index, built: Built) -> tuple[Array, Index, Index]:
    """Return the best rigid move (1, 3) of the group, and the pairs (P,), (P,) of its landmarks and older ones.

    The pairs are those that the move explains. None, and a move of 0, where no move is clearly the best.
    """
    nothing = np.zeros((1, 3)), group[:0], older[:0]
    if len(group) < _FEWEST:
        return nothing
    near = np.hypot(*(points[group].T[:, :, None] - points[older].T[:, None])) < _FARTHEST_M
    looks = looks_alike(built.side[group, None], built.polarity[group, None], built.side[older], built.polarity[older])
    may_be = near & (looks >= 0)
    likely = np.flatnonzero(may_be.any(axis=0))
    likely = np.sort(likely[np.argsort(-built.count[older[likely]], kind="stable")[:_MOST_OLDER]])
    older, may_be = older[likely], may_be[:, likely]
    if len(older) < _FEWEST:
        return nothing
    row, column = np.nonzero(may_be)
    moves = _moves(points[group], points[older], row, column)
    if len(moves) == 0:
        return nothing
    explained = compiled(explained_loop)
    count = explained(points[group], points[older], row, column, moves, _CLOSE_M)[0]
    best = int(count.argmax())
    middle = points[group].mean(axis=0)
    away = np.linalg.norm(_moved(middle, moves) - _moved(middle, moves[best : best + 1]), axis=-1)
    alternative = count[away > _OTHER_M].max(initial=0)
    if count[best] < max(_FEWEST, _SHARE * len(group), _CLEARLY * alternative):
        return nothing
    move = moves[best : best + 1]
    for _ in range(_REFINEMENTS):
        match = explained(points[group], points[older], row, column, move, _CLOSE_M)[1]
        new = np.flatnonzero(match >= 0)
        pose = best_motion(points[older[match[new]]], points[group[new]])
        move = pose[None] * [1.0, 1.0, -1.0]  # headings turn the other way round in the plane (x, z)
    # What is brought near several older ones, or near one that others come near, is left for when the loop is closed.
    near_now = np.linalg.norm(_moved(points[group], move)[row] - points[older][column], axis=-1) < _CLOSE_M
    by_new, by_old = (
        np.bincount(row[near_now], minlength=len(group)),
        np.bincount(column[near_now], minlength=len(older)),
    )
    new = new[np.isin(new, row[near_now & (by_new[row] == 1) & (by_old[column] == 1)])]
    return move, group[new], older[match[new]]


def _moves(new: Array, old: Array, row: Index, column: Index) -> Array:
    """Return the rigid moves (M, 3), x, z and turn, that take two landmarks of the group onto two older ones."""
    one, other = compiled(alike_pairs_loop)(new, old[column], row, _BASELINE_M, _CLOSE_M, _MOST_MOVES)
    baseline, older = new[row[other]] - new[row[one]], old[column[other]] - old[column[one]]
    turn = wrap_angle(np.arctan2(older[:, 1], older[:, 0]) - np.arctan2(baseline[:, 1], baseline[:, 0]))
    kept = np.abs(turn) < _TURN_MOST_RAD
    one, other, turn = one[kept], other[kept], turn[kept]
    middle = (new[row[one]] + new[row[other]]) / 2
    target = (old[column[one]] + old[column[other]]) / 2
    shift = target - _moved(middle, np.column_stack([np.zeros((len(turn), 2)), turn]))
    return np.column_stack([shift, turn])


def _moved(points: Array, moves: Array) -> Array:
    """Return points (..., 2) moved by each of the moves (M, 3)."""
    cos, sin = np.cos(moves[:, 2]), np.sin(moves[:, 2])
    x, z = points[..., 0], points[..., 1]
    return np.stack([cos * x - sin * z, sin * x + cos * z], axis=-1) + moves[:, :2]


# -- loops for numba to compile, when they are called ------------------------------------------------------------------


def explained_loop(
    new: Array, old: Array, row: Index, column: Index, moves: Array, close_m: float
) -> tuple[Index, Index]:
    """Return how many of the group (A, 2) each move (M, 3) brings onto older ones (B, 2), and the last one's match.

    row, column: (P,) pairs that may be one. Two match that are each other's nearest and nearer than `close_m`. match:
    (A,) the older landmark of each, -1 for none. Plain loops, for numba to compile.
    """
    count = np.zeros(len(moves), dtype=np.int64)
    match, back = np.empty(len(new), dtype=np.int64), np.empty(len(old), dtype=np.int64)
    nearest, nearest_back = np.empty(len(new)), np.empty(len(old))
    for m in range(len(moves)):
        cos, sin = np.cos(moves[m, 2]), np.sin(moves[m, 2])
        match[:], back[:] = -1, -1
        nearest[:], nearest_back[:] = close_m**2, close_m**2
        for k in range(len(row)):
            a, b = row[k], column[k]
            x = cos * new[a, 0] - sin * new[a, 1] + moves[m, 0] - old[b, 0]
            z = sin * new[a, 0] + cos * new[a, 1] + moves[m, 1] - old[b, 1]
            apart = x * x + z * z
            if apart < nearest[a]:
                nearest[a], match[a] = apart, b
            if apart < nearest_back[b]:
                nearest_back[b], back[b] = apart, a
        for a in range(len(new)):
            if match[a] >= 0 and back[match[a]] == a:
                count[m] += 1
            else:
                match[a] = -1
    return count, match


def alike_pairs_loop(
    new: Array, old: Array, row: Index, baseline_m: float, close_m: float, most: int
) -> tuple[Index, Index]:
    """Return two of the matches (P,) each (M,) whose landmarks are as far apart in the group as among the older ones.

    new: (A, 2) places of the group, row: (P,) which of them a match has, old: (P, 2) where its older one stands. Nearer
    than `baseline_m` they tell no turn. Of more than `most`, every second, third … one. Plain loops for numba.
    """
    length = np.sqrt((new[:, :1] - new[:, 0]) ** 2 + (new[:, 1:] - new[:, 1]) ** 2)
    # Squares of the distances that count as the same; none does where the baseline is too short.
    least, largest = np.maximum(length - close_m, 0.0) ** 2, np.where(length > baseline_m, (length + close_m) ** 2, 0.0)
    one, other = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    every, met, kept = 1, 0, 0
    for i in range(len(row)):
        low, high = least[row[i]], largest[row[i]]
        for j in range(i + 1, len(row)):
            apart = (old[j, 0] - old[i, 0]) ** 2 + (old[j, 1] - old[i, 1]) ** 2
            if apart <= low[row[j]] or apart >= high[row[j]]:
                continue
            if met % every == 0:
                if kept == most:
                    kept = most // 2
                    one[:kept], other[:kept] = one[: 2 * kept : 2].copy(), other[: 2 * kept : 2].copy()
                    every *= 2
                if met % every == 0:
                    one[kept], other[kept] = i, j
                    kept += 1
            met += 1
    return one[:kept], other[:kept]
