"""The inner loop of `ambiguity`, for numba to compile: poses are moved to where their views look most alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array


def search_loop(  # noqa: PLR0912  (numba compiles one loop best)
    poses: Array,
    starts: Array,
    points: Array,
    polarity: NDArray[np.int64],
    limits: Array,
    gates: Array,
    start_sigma: Array,
    sigma: float,
    density: float,
    found: float,
) -> tuple[Array, Array]:
    """Return the poses (N, 3) near `starts` that look most like `poses`, and the nats (N,) that part the two.

    Each landmark of the view is matched with the nearest that the other pose shows, which is then moved to where all
    fit best, by damped Gauss-Newton; again for each of the gates (rad). limits: as `_limits`. start_sigma: (3,) how far
    a start may be off. Plain loops, for numba to compile.
    """
    twins, nats = starts.copy(), np.empty(len(poses))
    z, sign = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
    b, slope, which = np.empty(len(points)), np.empty((len(points), 3)), np.empty(len(points), dtype=np.int64)
    peak = found / (sigma * np.sqrt(2 * np.pi))
    for n in range(len(poses)):
        seen, own = 0, 0.0
        for step in range(len(gates) + 2):
            # First the pose itself is looked from, last the twin once more, to see how alike the two are.
            pose = poses[n] if step == 0 else twins[n]
            cos, sin = np.cos(pose[2]), np.sin(pose[2])
            shown = 0
            for k in range(len(points)):
                dx, dz = points[k, 0] - pose[0], points[k, 1] - pose[1]
                right, ahead = cos * dx - sin * dz, -(sin * dx + cos * dz)
                square = dx * dx + dz * dz
                inside = ahead > 0 and abs(right) < ahead * limits[0]
                if inside and square > limits[1] ** 2 and square < limits[2] ** 2:
                    b[shown], which[shown] = np.arctan2(right, ahead), k
                    # Heading - bearing is the direction atan2(-dx, -dz) of the landmark in the map.
                    slope[shown] = np.array([dz / square, -dx / square, 1.0])
                    shown += 1
            if step == 0:
                seen = shown
                z[:shown] = b[:shown]
                for i in range(shown):
                    sign[i] = polarity[which[i]]
            if step == 0 or step == len(gates) + 1:
                likely = -found * shown
                for i in range(seen):
                    there = density
                    for j in range(shown):
                        if sign[i] * polarity[which[j]] >= 0:
                            there += peak * np.exp(-0.5 * ((z[i] - b[j]) / sigma) ** 2)
                    likely += found * np.log(there)
                own, nats[n] = (likely, 0.0) if step == 0 else (own, own - likely)
                continue
            gate = gates[step - 1]
            normal, right_side = np.diag((gate / start_sigma) ** 2), np.zeros(3)
            for i in range(seen):
                nearest, match = gate, -1
                for j in range(shown):
                    if abs(z[i] - b[j]) < nearest and sign[i] * polarity[which[j]] >= 0:
                        nearest, match = abs(z[i] - b[j]), j
                if match >= 0:
                    for row in range(3):
                        right_side[row] += slope[match, row] * (z[i] - b[match])
                        for column in range(3):
                            normal[row, column] += slope[match, row] * slope[match, column]
            twins[n] += np.linalg.solve(normal, right_side)
        twins[n, 2] = (twins[n, 2] + np.pi) % (2 * np.pi) - np.pi
    return twins, nats
