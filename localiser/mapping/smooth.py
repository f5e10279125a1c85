"""Batch smoothing: poses, landmarks, and constant errors of wheels and mount, as one sparse least-squares problem.

Factors: odometry between consecutive frames, with a constant scale of distance and of rotation and a veer; bearings of
landmarks; priors on the constants, that of the distance scale from feet on the floor. The first pose is fixed and
defines the frame. Levenberg-Marquardt over a sparse factorisation [Dellaert, Kaess 2006], robust by Cauchy's weights.

Bearings alone do not determine the scale. A camera of known height sees the distance of an edge's foot on the floor. A
foot above the floor, or a hidden one, appears farther away, never nearer. So the ratios of apparent to current distance
have a sharp lower limit, which is the scale.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, compose
from localiser.mapping.factors import CONSTANTS, Problem, State, Steps, cost_of, landmark_columns, linearise
from localiser.mapping.sightings import Index, Sightings, direction_of
from localiser.mapping.sparse import Factor

# -- the scale by feet on the floor -----------------------------------------------------------------------------------

_FARTHEST_M = 6.0  # beyond, two pixels are a tenth of the distance
_FEWEST_FEET, _FEWEST_SIGHTINGS = 5, 3
_FOOT_SIGMA = 0.012  # of the logarithm of a landmark's ratio: floors are not plane, feet not sharp
_STANDING = (0.1, 0.3, 0.5, 0.7, 0.9)  # share of feet on the floor: each as likely as the others
_FEWEST_STANDING = 0.3  # share of feet that must agree on where the floor is
_WRONG = 0.1  # share of ratios that may be anything; the rest is above the floor
_HIGHEST = 0.4  # logarithm of the ratio of what ends at a third of the camera's height
_ANYTHING = 2.0  # span of the logarithm of wrong ratios
_LEAST_SIGMA = 0.005  # the camera's stated height and tilt are no better known


@dataclass(frozen=True, slots=True)
class Scale:
    """The logarithm of true over present distances, and its sigma; infinite where no foot tells."""

    log: float
    sigma: float


def scale_by_floor_contacts(sightings: Sightings, of: Index, points: Array, cameras: Array, prior: Scale) -> Scale:
    """Return by what factor all distances should grow; `of` (S,) says which landmark (L, 2) a sighting shows.

    prior: the same factor by what is known without feet. The mixture of the module's text over the median ratios of
    the landmarks.
    """
    ratio = _ratios(sightings, of, points, cameras)
    if len(ratio) < _FEWEST_FEET:
        return Scale(0.0, np.inf)
    grid = prior.log + prior.sigma * np.linspace(-3.0, 3.0, 801)
    above = ratio[None] - grid[:, None]
    on_floor = np.exp(-0.5 * (above / _FOOT_SIGMA) ** 2) / (_FOOT_SIGMA * np.sqrt(2 * np.pi))
    higher = ((above > 0) & (above < _HIGHEST)) / _HIGHEST
    right = [share * on_floor + (1 - share) * higher for share in _STANDING]
    by_share = [np.log((1 - _WRONG) * density + _WRONG / _ANYTHING).sum(axis=1) for density in right]
    score = np.logaddexp.reduce(by_share) - 0.5 * ((grid - prior.log) / prior.sigma) ** 2
    posterior = np.exp(score - score.max())
    posterior /= posterior.sum()
    mean = float(posterior @ grid)
    if (np.abs(ratio - mean) < 2 * _FOOT_SIGMA).mean() < _FEWEST_STANDING:
        return Scale(0.0, np.inf)  # skirting boards, tables: what looks like the floor may be anything
    return Scale(mean, float(np.hypot(np.sqrt(posterior @ (grid - mean) ** 2), _LEAST_SIGMA)))


def _ratios(sightings: Sightings, of: Index, points: Array, cameras: Array) -> Array:
    """Return the logarithms of apparent over present distance, the median of each landmark with feet that agree."""
    seen: NDArray[np.int64] = np.flatnonzero((of >= 0) & (sightings.foot_m < _FARTHEST_M))
    landmark = of[seen]
    _, range_m = direction_of(points[landmark], cameras[sightings.frame[seen]])
    apparent = np.log(sightings.foot_m[seen] / np.maximum(range_m, 1e-3))
    order = np.argsort(landmark, kind="stable")
    ratios = []
    for index in np.split(order, np.flatnonzero(np.diff(landmark[order])) + 1):
        if len(index) < _FEWEST_SIGHTINGS:
            continue
        middle = float(np.median(apparent[index]))
        if np.median(np.abs(apparent[index] - middle)) < 2 * _FOOT_SIGMA:
            ratios.append(middle)
    return np.array(ratios)


# -- the path ---------------------------------------------------------------------------------------------------------

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
        result, pairs = np.empty((len(one), 2, 2)), np.stack([one, other])
        for near in halved(self.points[one], lambda part: len(np.unique(pairs[:, part])) <= _FEW_LANDMARKS):
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


def halved(places: Array, is_small: Callable[[Index], bool]) -> list[Index]:
    """Return the places (P, 2) in parts that are small, their indices in order: divided at the median again and again.

    is_small: whether a part, given by its indices, need not be divided.
    """
    parts, done = [np.arange(len(places))] if len(places) else [], []
    while parts:
        part = parts.pop()
        along = places[part, np.ptp(places[part], axis=0).argmax()]
        left = along < np.median(along)
        if is_small(part) or not left.any():
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
    factor, damping, harder = Factor(), 1e-4, 2.0
    for _ in range(iterations):
        normal, gradient = linear.normal()
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
    factor.update(linear.normal()[0])
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


def dead_reckoning(wheels: Steps) -> Array:
    """Return the poses (T, 3) from the wheels alone, the first one at the origin."""
    poses = [np.zeros(3)]
    for motion in wheels.motion:
        poses.append(compose(poses[-1], motion))
    return np.array(poses)
