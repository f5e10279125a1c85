"""Loops over the grey values beside edges, for numba to compile."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array


def sides_loop(
    image: NDArray[np.uint8], nodes: Array, before: NDArray[np.int64], share: Array, sides_px: Array, outwards: int
) -> Array:
    """Return mean grey values (E, S, 2) left and right of polylines (E, N, 2), nan from where they leave the image.

    before, share: (S,) which node each place lies behind, and how far on the way to the next. sides_px: (K,) offsets
    along u, the first half of them to the left. outwards: the first place that may follow on from one outside.
    """
    lines, places, half = len(nodes), len(before), len(sides_px) // 2
    last_u, last_v, reach = image.shape[1] - 1, image.shape[0] - 1, np.abs(sides_px).max()
    grey = np.full((lines, places, 2), np.nan)
    for line in range(lines):
        for place in range(places):
            n, part = before[place], share[place]
            u = nodes[line, n, 0] * (1 - part) + nodes[line, n + 1, 0] * part
            v = nodes[line, n, 1] * (1 - part) + nodes[line, n + 1, 1] * part
            if not (reach <= u <= last_u - reach and 0 <= v <= last_v):
                if place >= outwards:  # a lens model may bend what is far outside back into the image
                    break
                continue
            top = min(int(v), last_v - 1)
            down = v - top
            for side in range(2):
                total = 0.0
                for k in range(half):
                    at = u + sides_px[side * half + k]
                    left = min(int(at), last_u - 1)
                    right = at - left
                    upper = image[top, left] * (1 - right) + image[top, left + 1] * right
                    lower = image[top + 1, left] * (1 - right) + image[top + 1, left + 1] * right
                    total += upper * (1 - down) + lower * down
                grey[line, place, side] = total / half
    return grey


def changes_loop(grey: Array, first: int, last: int) -> Array:
    """Return by how much grey values (E, S, 2) change at most between two places and the next two: (E, 2).

    From place `first` on up to, not including, `last`; 0 where nothing is seen.
    """
    changes = np.zeros((len(grey), 2))
    for line in range(len(grey)):
        for side in range(2):
            for k in range(first, last - 3):
                before = grey[line, k, side] + grey[line, k + 1, side]
                change = abs(before - grey[line, k + 2, side] - grey[line, k + 3, side]) / 2
                if change > changes[line, side]:  # noqa: PLR1730  (never for nan)
                    changes[line, side] = change
    return changes
