"""Batch smoothing: poses, landmarks, and what is wrong with wheels and mount, as one sparse least-squares problem.

Factors: odometry between consecutive frames, with a constant scale of distance and of rotation and a veer; bearings of
landmarks; priors on the constants, that of the distance scale from feet on the floor. The first pose is the gauge.
Levenberg-Marquardt over a sparse factorisation [Dellaert, Kaess 2006], robust by Cauchy's weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from localiser.geometry import Array, compose
from localiser.mapping.factors import CONSTANTS, Problem, State, Wheels, cost_of, linearise

_ITERATIONS = 25
_CONVERGED = 1e-4  # relative fall of the cost below which nothing changes any more


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """Robot poses (T, 3), landmarks (L, 2), constants (4,) as in `CONSTANTS`, and the final linear system.

    weight: (K,) of each bearing by the robust cost. residual: (K,) rad.
    """

    poses: Array
    points: Array
    constants: Array
    residual: Array
    weight: Array
    cost: float
    hessian: Any

    def landmark_cov(self) -> Array:
        """Return the joint covariance (2L, 2L) m² of all landmarks, in the frame of the first pose.

        By eliminating the landmarks, whose own block of the system is block-diagonal: Σ = D⁻¹ + D⁻¹ Bᵀ S⁻¹ B D⁻¹ with
        S = A - B D⁻¹ Bᵀ [Triggs et al. 1999].
        """
        count = 2 * len(self.points)
        first = self.hessian.shape[0] - count
        hessian = self.hessian.tocsr()
        poses, cross = hessian[:first, :first].toarray(), hessian[:first, first:].toarray()
        own = hessian[first:, first:].tocsr()
        blocks = np.stack([own.diagonal()[0::2], own.diagonal(1)[0::2], own.diagonal()[1::2]], axis=-1)
        inverse = np.zeros((count // 2, 2, 2))
        determinant = blocks[:, 0] * blocks[:, 2] - blocks[:, 1] ** 2
        inverse[:, 0, 0], inverse[:, 1, 1] = blocks[:, 2] / determinant, blocks[:, 0] / determinant
        inverse[:, 0, 1] = inverse[:, 1, 0] = -blocks[:, 1] / determinant
        scaled = np.einsum("plj,ljk->plk", cross.reshape(first, -1, 2), inverse).reshape(first, count)
        reduced = poses - scaled @ cross.T
        cov = scaled.T @ np.linalg.solve(reduced, scaled)
        for index in range(count // 2):
            cov[2 * index : 2 * index + 2, 2 * index : 2 * index + 2] += inverse[index]
        return np.asarray(cov)


def smooth(problem: Problem, poses: Array, points: Array, constants: Array, iterations: int = _ITERATIONS) -> Smoothed:
    """Return the poses (T, 3), landmarks (L, 2) and constants (4,) that fit best, from a start near them."""
    from scipy.sparse.linalg import splu

    state = State(poses, points, constants, points)
    residual, weight, jacobian = linearise(problem, state)
    cost = cost_of(problem, state)
    damping = 1e-4
    for _ in range(iterations):
        weighted = jacobian.T.multiply(weight).tocsc()
        hessian = (weighted @ jacobian).tocsc()
        gradient = weighted @ residual
        diagonal = hessian.diagonal()
        while True:
            damped = hessian.copy()
            damped.setdiag(diagonal * (1 + damping) + 1e-9)
            step = splu(
                damped, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            ).solve(gradient)
            moved = state.moved(step)
            new_cost = cost_of(problem, moved)
            if new_cost < cost or damping > 1e6:
                break
            damping *= 10
        fell = cost - new_cost
        if fell <= 0:
            break
        state, cost, damping = moved, new_cost, max(damping / 10, 1e-9)
        residual, weight, jacobian = linearise(problem, state)
        if fell < _CONVERGED * cost:
            break
    weighted = jacobian.T.multiply(weight).tocsc()
    hessian = (weighted @ jacobian).tocsc()
    hessian.setdiag(hessian.diagonal() + 1e-9)
    first = 3 * (len(poses) - 1) + len(CONSTANTS)
    count = len(problem.bearings.bearing)
    return Smoothed(
        state.poses,
        state.points,
        state.constants,
        residual[first : first + count] * problem.bearings.sigma,
        weight[first : first + count],
        cost,
        hessian,
    )


def dead_reckoned(wheels: Wheels) -> Array:
    """Return the poses (T, 3) from the wheels alone, the first one at the origin."""
    poses = [np.zeros(3)]
    for motion in wheels.motion:
        poses.append(compose(poses[-1], motion))
    return np.array(poses)
