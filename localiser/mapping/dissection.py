"""In which order poses and landmarks are eliminated so that little fills in: nested dissection along time.

A pose, and the landmarks that are seen on both sides of it, part a stretch of time in two [George 1973]; both halves
are eliminated before them. Of the middle half, the pose that the fewest landmarks span: where a robot turns a corner
it leaves most of them behind.
"""

from __future__ import annotations

import numpy as np

from localiser.mapping.sightings import Index

_SHORT = 4  # frames that are not worth parting


def dissected(frames: int, frame: Index, landmark: Index, landmarks: int) -> Index:
    """Return poses and landmarks in the order of elimination: numbers below `frames` are poses, the rest landmarks.

    frame, landmark: (K,) which landmark each bearing is of, and when. The first pose is fixed, and left out.
    """
    first, last = np.full(landmarks, frames - 1), np.ones(landmarks, dtype=np.int64)
    np.minimum.at(first, landmark, np.maximum(frame, 1))
    np.maximum.at(last, landmark, frame)
    backwards: list[Index] = []
    stretches = [(1, frames, np.arange(landmarks))]
    while stretches:
        begin, end, inside = stretches.pop()
        if end - begin <= _SHORT:
            backwards += [np.arange(begin, end), frames + inside]
            continue
        middle = begin + _parting(first[inside] - begin, last[inside] - begin, end - begin)
        before = last[inside] <= middle
        after = ~before & (first[inside] >= middle)
        backwards += [np.array([middle]), frames + inside[~before & ~after]]
        stretches += [(begin, middle, inside[before]), (middle + 1, end, inside[after])]
    return np.concatenate(backwards)[::-1]


def _parting(first: Index, last: Index, length: int) -> int:
    """Return the frame, of the middle half of a stretch, that the fewest landmarks (L) are seen on both sides of."""
    begun, ended = (np.bincount(x, minlength=length + 1)[:length] for x in (first + 1, last))
    middle = np.arange(length // 4, length - length // 4)
    spanning, off = np.cumsum(begun - ended)[middle], np.abs(2 * middle - length)
    return int(middle[np.lexsort((off, spanning))[0]])
