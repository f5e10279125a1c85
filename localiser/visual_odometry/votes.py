"""Pairs of edges vote for turns, compiled by numba: imported only once edges are followed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array
from localiser.geometry.compiled import compiled


@compiled
def votes(
    offset_bearing: Array,
    inverse: Array,
    spread: Array,
    bearing: Array,
    look: Array,
    moves: Array,
    cell: Array,
    first_turn: float,
    turn_step: float,
    bins: int,
    widths: Array,
    kernels: Array,
    reaches: NDArray[np.int64],
) -> Array:
    """Return the votes (G, B) of P pairs for B turns under each of G moves (x, z of the camera).

    offset_bearing: change of bearing (P,) is that minus the first. kernels: (W, R) what a vote of each of W widths
    gives to its R next bins, of which `reaches` (W,) are not 0. cell: (2,) half of the distance between moves.
    """
    result = np.zeros((len(moves), bins))
    for p in range(len(look)):
        sin, cos = np.sin(bearing[p]), np.cos(bearing[p])
        by_cell = inverse[p] * np.sqrt((cos * cell[0]) ** 2 + (sin * cell[1]) ** 2) / 2.0
        for g in range(len(moves)):
            x, z = moves[g]
            expected = np.arctan2(sin - inverse[p] * x, cos + inverse[p] * z)
            parallax = spread[p] * (cos * x + sin * z)
            width = np.sqrt(parallax**2 + by_cell**2)
            kind = 0
            while kind < len(widths) - 1 and widths[kind] < width:
                kind += 1
            turn = offset_bearing[p] - expected
            turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
            middle = int(np.round((turn - first_turn) / turn_step))
            reach = reaches[kind]
            for column in range(max(middle - reach + 1, 0), min(middle + reach, bins)):
                result[g, column] += look[p] * kernels[kind, abs(column - middle)]
    return result
