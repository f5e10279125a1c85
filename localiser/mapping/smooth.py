"""Batch smoothing: poses, landmarks, and constant errors of wheels and mount, as one sparse least-squares problem.

Factors: odometry between consecutive frames, with a constant scale of distance and of rotation and a veer; bearings of
landmarks; priors on the constants, that of the distance scale from feet on the floor. The first pose is fixed and
defines the frame. Levenberg-Marquardt over a sparse factorisation [Dellaert, Kaess 2006], robust by Cauchy's weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from localiser.geometry import Array, compose
from localiser.mapping.factors import CONSTANTS, Problem, State, Wheels, cost_of, landmark_columns, linearise
from localiser.mapping.sightings import Index
from localiser.mapping.sparse import Factor, Pattern

_ITERATIONS = 25
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e6
_FEW_LANDMARKS = 150  # whose covariances with each other are computed at one time
CONVERGED = 1e-4
"""Relative fall of the cost below which nothing changes any more."""


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """Robot poses (T, 3), landmarks (L, 2), constants (4,) as in `factors`, and the final linear system, factored.

    weight: (K,) of each bearing by the robust cost. residual: (K,) rad.
    """

    poses: Array
    points: Array
    constants: Array
    residual: Array
    weight: Array
    cost: float
    factor: Factor

    def landmark_cov(self) -> Array:
        """Return the covariance (L, 2, 2) m² of each landmark, in the frame of the first pose."""
        return self.factor.projected(self._columns(np.arange(len(self.points))))

    def difference_cov(self, one: Index, other: Index) -> Array:
        """Return the covariance (P, 2, 2) m² of the differences of pairs of landmarks."""
        result = np.empty((len(one), 2, 2))
        for near in _of_few_landmarks(self.points, one, other):
            cov, i, j = self._joint_cov(one[near], other[near])
            result[near] = cov[i, i] + cov[j, j] - cov[i, j] - cov[j, i]
        return result

    def joint_difference_cov(self, one: Index, other: Index) -> Array:
        """Return the covariance (2 P, 2 P) m² of the differences of P pairs of landmarks, all with each other."""
        cov, i, j = self._joint_cov(one, other)
        of_pairs = cov[i] - cov[j]
        return np.asarray((of_pairs[:, i] - of_pairs[:, j]).transpose(0, 2, 1, 3).reshape(2 * len(one), -1))

    def _joint_cov(self, one: Index, other: Index) -> tuple[Array, Index, Index]:
        """Return the covariances (A, A, 2, 2) m² of the landmarks in pairs (P,), and which of them pairs consist of."""
        landmark, index = np.unique(np.stack([one, other]), return_inverse=True)
        count, (i, j) = len(landmark), index.reshape(2, -1)
        cov = self.factor.joint(self._columns(landmark))
        return cov.reshape(count, 2, count, 2).transpose(0, 2, 1, 3), i, j

    def constants_cov(self) -> Array:
        """Return the covariance (4, 4) of the constants."""
        return self.factor.joint(self._picked(3 * (len(self.poses) - 1) + np.arange(len(CONSTANTS))))

    def _columns(self, landmark: Index) -> Any:
        """Return the sparse columns (V, 2 P) that pick x and z of landmarks (P,) out of the variables."""
        return self._picked(landmark_columns(len(self.poses), landmark).ravel())

    def _picked(self, row: Index) -> Any:
        """Return the sparse columns (V, C) that pick the variables (C,) at `row`."""
        from scipy.sparse import csc_array

        size = int(landmark_columns(len(self.poses), np.array([len(self.points)]))[0, 0])
        return csc_array((np.ones(len(row)), (row, np.arange(len(row)))), shape=(size, len(row)))


def _of_few_landmarks(points: Array, one: Index, other: Index) -> list[Index]:
    """Return pairs (P,) of landmarks (L, 2) in parts of few landmarks each: those that are near each other."""
    parts, done = [np.arange(len(one))] if len(one) else [], []
    while parts:
        part = parts.pop()
        place = points[one[part]]
        along = place[:, np.ptp(place, axis=0).argmax()]
        left = along < np.median(along)
        if len(np.unique(np.stack([one[part], other[part]]))) <= _FEW_LANDMARKS or not left.any():
            done.append(part)
        else:
            parts += [part[left], part[~left]]
    return done


def smooth(
    problem: Problem,
    poses: Array,
    points: Array,
    constants: Array,
    iterations: int = _ITERATIONS,
    converged: float = CONVERGED,
) -> Smoothed:
    """Return the poses (T, 3), landmarks (L, 2) and constants (4,) that fit best, from a start near them.

    converged: relative fall of the cost below which nothing changes any more. Levenberg-Marquardt; the damping follows
    how much of the fall that the linear problem promised came true [Nielsen 1999].
    """
    state = State(poses, points, constants, points)
    linear, cost = linearise(problem, state), cost_of(problem, state)
    pattern, factor, damping, harder = Pattern.of(linear), Factor(), 1e-4, 2.0
    for _ in range(iterations):
        pattern = pattern if pattern.holds(linear) else Pattern.of(linear)
        normal, gradient = linear.normal(pattern)
        while True:
            factor.update(normal, damping)
            step = factor.solve(gradient)
            moved = state.moved(step)
            new_cost = cost_of(problem, moved)
            if new_cost < cost or damping > _MOST_DAMPING:
                break
            damping, harder = harder * damping, 2 * harder
        fell = cost - new_cost
        if not fell > 0:
            break
        promised = float(step @ (gradient + damping * normal.diagonal() * step))
        easier = 1 - (2 * min(fell / promised, 1.0) - 1) ** 3
        damping, harder = max(damping * max(easier, 0.1), _LEAST_DAMPING), 2.0
        state, cost, linear = moved, new_cost, linearise(problem, moved)
        if max(fell, promised) < converged * cost:
            break
    factor.update(linear.normal(pattern if pattern.holds(linear) else None)[0])
    count = len(problem.bearings.bearing)
    return Smoothed(
        state.poses,
        state.points,
        state.constants,
        linear.residual[:count] * problem.bearings.sigma,
        linear.weight[:count],
        cost,
        factor,
    )


def dead_reckoned(wheels: Wheels) -> Array:
    """Return the poses (T, 3) from the wheels alone, the first one at the origin."""
    poses = [np.zeros(3)]
    for motion in wheels.motion:
        poses.append(compose(poses[-1], motion))
    return np.array(poses)
