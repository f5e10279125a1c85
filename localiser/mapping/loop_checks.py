"""Whether loops that were closed are right: by the score of each visit, and by what the wheels measured.

A wrong loop closure bends the poses until its bearings fit, so their residuals stay small. But the gradient of the cost
at this visit is large. Suppose that the visit had its own landmark. Where this landmark would be, and by how much the
cost would fall, follows from the linear problem at the solution, without solving it again [Rao 1948].

Wrong loops bend a path until the bearings fit. What they leave behind is a path that the wheels should have measured
otherwise: by a constant error that is not credible, or by more than their noise over some stretch of the way.
"""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array
from localiser.mapping.factors import (
    CONSTANTS,
    Prior,
    Problem,
    State,
    Wheels,
    bearing_block,
    variables,
    wheel_residuals,
)
from localiser.mapping.sightings import Index
from localiser.mapping.smooth import Smoothed

# -- the score test ---------------------------------------------------------------------------------------------------

_GATE = 11.8  # 99.7 % of a Gaussian in the plane
_LEAST_SIGMA_M = 0.008  # from its other side, an edge is the other side of a frame or a strip
_APART_FRAMES = 30  # without a landmark, after which it is visited again


def without_contradicting_visits(problem: Problem, smoothed: Smoothed, of: Index, used: Index) -> Index:
    """Return the landmarks `of` (S,) with the visits that contradict their landmarks as landmarks of their own.

    used: (K,) the sightings that are the bearings of the problem. Of visits at one time only the worst leaves: it may
    be why the others seem to contradict.
    """
    landmark = problem.bearings.landmark
    visit = visits(landmark, problem.bearings.frame)
    owner = np.zeros(visit.max(initial=-1) + 1, dtype=np.int64)
    owner[visit] = landmark
    several = np.flatnonzero(np.bincount(owner)[owner] > 1)
    if len(several) == 0:
        return of
    chi2 = visit_contradiction(problem, smoothed, visit, several)
    leaves = several[_worst_of_their_time(problem.bearings.frame, visit, several, chi2)]
    parted = of.copy()
    gone = np.isin(visit, leaves)
    parted[used[gone]] = len(smoothed.points) + visit[gone]
    return parted


def _worst_of_their_time(frame: Index, visit: Index, asked: Index, chi2: Array) -> Index:
    """Return which of the visits asked (V,) contradict, but for those that share a frame with a worse one."""
    taken = np.zeros(int(frame.max()) + 1, dtype=bool)
    leaving = []
    for index in np.argsort(-chi2, kind="stable")[: (chi2 > _GATE).sum()]:
        frames = frame[visit == asked[index]]
        if not taken[frames.min() : frames.max() + 1].any():
            taken[frames.min() : frames.max() + 1] = True
            leaving.append(int(index))
    return np.array(leaving, dtype=np.int64)


def visits(landmark: Index, frame: Index) -> Index:
    """Return the number (K,) of the visit that each bearing belongs to: a landmark's sightings without a long pause."""
    order = np.lexsort((frame, landmark))
    begins = (np.diff(landmark[order]) != 0) | (np.diff(frame[order]) > _APART_FRAMES)
    visit = np.zeros(len(landmark), dtype=np.int64)
    visit[order[1:]] = np.cumsum(begins)
    return visit


def visit_contradiction(problem: Problem, smoothed: Smoothed, visit: Index, asked: Index) -> Array:
    """Return for each visit `asked` (V,) how many squared sigmas its own landmark would stand from the present one.

    With cost(δ) = cost - 2 λᵀδ + δᵀMδ for a landmark of its own at distance δ, all else at its best: λ is the pull of
    the visit's bearings, M their information less what poses and landmark take up. visit: (K,).
    """
    pull, information = _pulls(problem, smoothed, visit, asked)
    # A visit that tells one direction only has no information along the other.
    known, axes = np.linalg.eigh(information)
    variance = 1 / np.maximum(known, 1e-6) + _LEAST_SIGMA_M**2
    offset = np.einsum("vji,vj->vi", axes, pull) / np.maximum(known, 1e-6)
    return np.asarray(np.where(known > 1e-3, offset**2 / variance, 0.0).sum(axis=1))


def _pulls(problem: Problem, smoothed: Smoothed, visit: Index, asked: Index) -> tuple[Array, Array]:
    """Return the pull (V, 2) of the bearings of each visit on its landmark, and its information (V, 2, 2)."""
    from scipy.sparse import csc_array

    state = State(smoothed.poses, smoothed.points, smoothed.constants, smoothed.points)
    bearing = bearing_block(problem, state)
    number = np.full(int(visit.max(initial=-1)) + 1, -1)
    number[asked] = np.arange(len(asked))
    kept = np.flatnonzero(number[visit] >= 0)
    own, shift = number[visit[kept]], bearing.value[kept, 3:5]
    weighted = bearing.weight[kept, None] * shift
    pull, information = np.zeros((len(asked), 2)), np.zeros((len(asked), 2, 2))
    np.add.at(pull, own, weighted * bearing.residual[kept, None])
    np.add.at(information, own, weighted[:, :, None] * shift[:, None])
    # Moving a visit's landmark, (K, 2 V), and what that asks of all variables of the problem.
    entries = weighted.ravel(), (np.repeat(np.arange(len(kept)), 2), (2 * own[:, None] + np.arange(2)).ravel())
    by_visit = csc_array(entries, shape=(len(kept), 2 * len(asked)))
    asks = bearing.jacobian(variables(state))[kept].T @ by_visit
    return pull, information - smoothed.factor.projected(asks.tocsc())


# -- the wheels -------------------------------------------------------------------------------------------------------

_CONSTANTS_CHI2 = 16.3  # 99.7 % of a Gaussian of four dimensions
_STRETCHES = (1, 10, 30, 100)  # steps between images, over which the noise is compared
_CHANCE = 0.003  # that the noise of right wheels alone contradicts a path


def contradicting_steps(wheels: Wheels, poses: Array, constants: Array) -> Index:
    """Return the steps (K,), each from image k to k + 1, in which a path contradicts the wheels."""
    chi2 = (wheel_residuals(wheels, poses, constants) ** 2).sum(axis=1)
    return np.flatnonzero(chi2 > _largest_chi2(len(chi2)))


def contradiction(wheels: Wheels, prior: Prior, poses: Array, constants: Array) -> str | None:
    """Return in words how a path contradicts the wheels; None where it does not.

    poses: (T, 3). constants: (4,) of wheels and mount, as in `factors.CONSTANTS`. prior: what is stated of them.
    """
    sigmas = (constants - prior.mean) / prior.sigma
    if sigmas @ sigmas > _CONSTANTS_CHI2:
        worst = int(np.abs(sigmas).argmax())
        return f"the wheels' constant errors would be {abs(sigmas[worst]):.1f} sigmas off ({CONSTANTS[worst]})"
    residual = wheel_residuals(wheels, poses, constants)
    gate = _largest_chi2(len(residual))
    for steps in _STRETCHES:
        count = len(residual) // steps
        sums = residual[: count * steps].reshape(count, steps, 3).sum(axis=1)
        chi2 = (sums**2).sum(axis=1) / steps
        if count and chi2.max() > gate:
            first = int(chi2.argmax()) * steps
            return f"the wheels would be {np.sqrt(chi2.max()):.1f} sigmas off from image {first} to {first + steps}"
    return None


def _largest_chi2(count: int) -> float:
    """Return what the largest χ² of `count` Gaussians of three dimensions exceeds with the probability `_CHANCE`.

    The longer the drive, the farther off the noise of its worst step.
    """
    from scipy.special import chdtri

    return float(chdtri(3, _CHANCE / max(count, 1)))
