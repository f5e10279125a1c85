"""Constant errors of the wheels: what a run has estimated, and least squares against the truth.

    true distance = (1 + distance_scale) · distance,    true turn = (1 + turn_scale) · turn + veer · distance

Least squares take pieces of 5 s: long enough that a robot which follows its commands a moment later does not matter,
short enough that the chord of a piece tells how far the robot drove. Only pieces with poses on the whole way count, so
that a clock which jumps, or a pause of years, costs nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, Trajectory, between
from localiser.particles import POSE, Estimate

PIECE_NS = 5_000_000_000
FEWEST_PIECES = 5
DECIMALS = 6


def fit_wheels(odometry: Trajectory, truth: Trajectory, from_ns: int, until_ns: int) -> dict[str, float]:
    """Return what constants of the wheels make odometry fit the truth best between two times, shares and rad/m.

    Empty where the two have less than some pieces in common, or the robot stood.
    """
    for track in (odometry, truth):
        from_ns, until_ns = max(from_ns, int(track.t_ns[0])), min(until_ns, int(track.t_ns[-1]))
    begins_ns = from_ns + PIECE_NS * np.unique((odometry.t_ns - from_ns) // PIECE_NS)
    begins_ns = begins_ns[(begins_ns >= from_ns) & (begins_ns + PIECE_NS < until_ns)]
    begins_ns = begins_ns[_is_covered(odometry, begins_ns) & _is_covered(truth, begins_ns)]
    if len(begins_ns) < FEWEST_PIECES:
        return {}
    wheels, true = (_pieces(track, begins_ns) for track in (odometry, truth))
    if np.linalg.matrix_rank(wheels) < 2:
        return {}
    distance = wheels[:, 0] @ true[:, 0] / (wheels[:, 0] @ wheels[:, 0])
    veer, turn = np.linalg.lstsq(wheels, true[:, 1], rcond=None)[0]
    return {"distance_scale": float(distance - 1), "turn_scale": float(turn - 1), "veer": float(veer)}


def bias_figures(estimate: Estimate, fit: dict[str, float]) -> dict[str, Any]:
    """Return value and sigma of every constant that is estimated, and by `least_squares` where `fit_wheels` has it."""
    sigma = np.sqrt(np.diag(estimate.cov))
    learnt = zip(estimate.names[len(POSE) :], estimate.mean[len(POSE) :], sigma[len(POSE) :], strict=True)
    return {
        name: {"value": _figure(value), "sigma": _figure(sigma)}
        | ({"least_squares": _figure(fit[name])} if name in fit else {})
        for name, value, sigma in learnt
        if sigma > 1e-9  # of what can be wrong
    }


def _is_covered(track: Trajectory, begins_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether (P,) the poses around and inside each piece are never further apart than a piece is long."""
    pauses = np.concatenate([[0], np.cumsum(np.diff(track.t_ns) > PIECE_NS)])
    before = np.searchsorted(track.t_ns, begins_ns, side="right") - 1
    after = np.searchsorted(track.t_ns, begins_ns + PIECE_NS, side="left")
    return np.asarray(pauses[after] == pauses[before])


def _pieces(track: Trajectory, begins_ns: NDArray[np.int64]) -> Array:
    """Return chord, backward counted negative, and turn (P, 2) of the motions in pieces that begin at times (P,)."""
    motion = between(*(track.sampled(times_ns).poses for times_ns in (begins_ns, begins_ns + PIECE_NS)))
    return np.stack([-np.sign(motion[:, 1]) * np.hypot(*motion[:, :2].T), motion[:, 2]], axis=1)


def _figure(value: float) -> float:
    return round(float(value), DECIMALS)
