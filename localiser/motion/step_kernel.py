"""Where particles get to by their draws of a step, compiled by numba when its loop is first called."""

from __future__ import annotations

from localiser.geometry import Array
from localiser.geometry.compiled import compiled


@compiled
def step_to(expected: Array, cos: Array, sin: Array, root: Array, normal: Array, columns: Array) -> None:
    """Write the poses of N particles after a step into the first three rows of `columns` (D, N).

    expected: (3, N) poses after the step that is expected. cos, sin: (N,) of the directions of travel. root: (3, 3), by
    which standard normal draws (3, N) become (along, left, turn).
    """
    for n in range(len(cos)):
        x, z, turn = 0.0, 0.0, 0.0
        for k in range(3):
            x += (-sin[n] * root[0, k] - cos[n] * root[1, k]) * normal[k, n]
            z += (sin[n] * root[1, k] - cos[n] * root[0, k]) * normal[k, n]
            turn += root[2, k] * normal[k, n]
        columns[0, n] = expected[0, n] + x
        columns[1, n] = expected[1, n] + z
        columns[2, n] = expected[2, n] + turn
