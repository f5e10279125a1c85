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
from localiser.mapping.sparse import Pattern

_ITERATIONS = 25
_POSE_BANDS = 5  # two neighbouring poses of three numbers
_COLUMNS = 256  # of a long matrix, solved for at a time
_REGULAR = 1e-9
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e6
CONVERGED = 1e-4
"""Relative fall of the cost below which nothing changes any more."""


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

        By eliminating the poses, whose own block of the system is banded, because wheels join neighbours only:
        Σ = (D - Bᵀ A⁻¹ B)⁻¹ [Triggs et al. 1999]. Time and memory grow with the log only in proportion.
        """
        return self._eliminated()[2][len(CONSTANTS) :, len(CONSTANTS) :]

    def taken_up(self, columns: Any) -> Array:
        """Return XᵀH⁻¹X (V, 2, 2) of V pairs of neighbouring `columns` (·, 2V), sparse, H being the system's matrix."""
        chain, cross, cov = self._eliminated()
        free = cross.shape[0]
        taken = np.empty((columns.shape[1] // 2, 2, 2))
        for first in range(0, columns.shape[1], _COLUMNS):
            part = columns.tocsc()[:, first : first + _COLUMNS].toarray()
            poses, rest = part[:free], part[free:]
            solved = _solved(chain, poses)
            left = rest - cross.T @ solved
            paired = [x.reshape(len(x), -1, 2) for x in (poses, solved, left, cov @ left)]
            by_poses, by_rest = (np.einsum("kvi,kvj->vij", *paired[i : i + 2], optimize=True) for i in (0, 2))
            taken[first // 2 : first // 2 + len(by_poses)] = by_poses + by_rest
        return taken

    def _eliminated(self) -> tuple[Array, Any, Array]:
        """Return the factor of the poses' block A, the block B that joins poses to the rest, and the rest's covariance.

        With B (3T - 3, 4 + 2L); the rest are constants and landmarks.
        """
        from scipy.linalg import cholesky_banded

        free = 3 * (len(self.poses) - 1)
        hessian = self.hessian.tocsc()
        cross, rest = hessian[:free, free:].tocsc(), hessian[free:, free:].toarray()
        chain = cholesky_banded(_upper_bands(hessian[:free, :free], _POSE_BANDS), check_finite=False)
        transposed = cross.T.tocsr()
        for first in range(0, rest.shape[1], _COLUMNS):
            part = slice(first, first + _COLUMNS)
            rest[:, part] -= transposed @ _solved(chain, cross[:, part].toarray())
        return chain, cross, _symmetric_inverse(rest)


def _solved(chain: Array, columns: Array) -> Array:
    """Return A⁻¹ times the columns (V, C), by the banded factor of A."""
    from scipy.linalg import cho_solve_banded

    return np.asarray(cho_solve_banded((chain, False), columns, check_finite=False))


def _upper_bands(matrix: Any, bands: int) -> Array:
    """Return the diagonal and the `bands` above it of a sparse matrix (V, V), as LAPACK stores them."""
    stored = np.zeros((bands + 1, matrix.shape[0]))
    for above in range(min(bands + 1, matrix.shape[0])):
        stored[bands - above, above:] = matrix.diagonal(above)
    return stored


def _symmetric_inverse(matrix: Array) -> Array:
    """Return the inverse of a positive definite matrix (V, V)."""
    from scipy.linalg import cho_factor, cho_solve

    return np.asarray(cho_solve(cho_factor(matrix, check_finite=False), np.eye(len(matrix)), check_finite=False))


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
    residual, weight, jacobian = linearise(problem, state)
    cost = cost_of(problem, state)
    damping, harder = 1e-4, 2.0
    pattern: Pattern | None = None
    for _ in range(iterations):
        hessian, gradient = _normal(jacobian, weight, residual)
        if pattern is None or not pattern.fits(hessian):
            pattern = Pattern.of(hessian)
        diagonal = hessian.diagonal()
        values = hessian.data.copy()
        while True:
            values[pattern.diagonal] = diagonal * (1 + damping) + _REGULAR
            step = pattern.solve(values, gradient)
            moved = state.moved(step)
            new_cost = cost_of(problem, moved)
            if new_cost < cost or damping > _MOST_DAMPING:
                break
            damping, harder = harder * damping, 2 * harder
        fell = cost - new_cost
        if not fell > 0:
            break
        promised = float(step @ (gradient + damping * diagonal * step))
        easier = 1 - (2 * min(fell / promised, 1.0) - 1) ** 3
        damping, harder = max(damping * max(easier, 0.1), _LEAST_DAMPING), 2.0
        state, cost = moved, new_cost
        residual, weight, jacobian = linearise(problem, state)
        if max(fell, promised) < converged * cost:
            break
    hessian, _ = _normal(jacobian, weight, residual)
    hessian.setdiag(hessian.diagonal() + _REGULAR)
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


def _normal(jacobian: Any, weight: Array, residual: Array) -> tuple[Any, Array]:
    """Return JᵀWJ (V, V), sparse with sorted columns, and JᵀW r (V,)."""
    weighted = jacobian.T.multiply(weight).tocsc()
    hessian = (weighted @ jacobian).tocsc()
    hessian.sort_indices()
    return hessian, weighted @ residual


def dead_reckoned(wheels: Wheels) -> Array:
    """Return the poses (T, 3) from the wheels alone, the first one at the origin."""
    poses = [np.zeros(3)]
    for motion in wheels.motion:
        poses.append(compose(poses[-1], motion))
    return np.array(poses)
