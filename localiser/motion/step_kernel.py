"""Where particles get to by their draws of a step, compiled by numba when its loop is first called."""

from __future__ import annotations

from localiser.geometry import Array
from localiser.geometry.compiled import compiled


@compiled
def step_to(start: Array, cos: Array, sin: Array, expected: Array, root: Array, normal: Array, end: Array) -> None:
    """Write the poses of N particles after a step into the first three rows of `end` (D, N).

    start: (3, N) poses. cos, sin: (N,) of the directions of travel. expected: (3, N) steps (along, left, turn). root:
    (3, 3), by which standard normal draws (3, N) become what a step differs from that.
    """
    for n in range(len(cos)):
        along, left, turn = expected[0, n], expected[1, n], expected[2, n]
        x, z, turned = 0.0, 0.0, 0.0  # by what is drawn
        for k in range(3):
            x += (-sin[n] * root[0, k] - cos[n] * root[1, k]) * normal[k, n]
            z += (sin[n] * root[1, k] - cos[n] * root[0, k]) * normal[k, n]
            turned += root[2, k] * normal[k, n]
        end[0, n] = start[0, n] + (-sin[n] * along - cos[n] * left) + x
        end[1, n] = start[1, n] + (sin[n] * left - cos[n] * along) + z
        end[2, n] = start[2, n] + turn + turned
