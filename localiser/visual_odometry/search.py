"""Votes for a start: turns that many pairs of edges agree on, for a coarse grid of translations (a Hough transform).

A pair votes for its change of bearing minus the parallax of the assumed translation. The vote is blurred by the
uncertainty of its range and of the grid.
"""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array
from localiser.visual_odometry.pairs import TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD, Pairs
from localiser.visual_odometry.sights import Sights

_REACH = 2.5  # sigmas of the prior that are searched
_BIN_RAD = np.deg2rad(0.25)
_WIDTHS_RAD = np.deg2rad([0.3, 0.6, 1.2, 2.4, 4.8])
_GRID = np.linspace(-1.0, 1.0, 7)
_MOST_BINS = 1440
_KERNEL_REACH = 3.0  # sigmas


def likely_motions(
    pairs: Pairs, sights: tuple[Sights, Sights], mount: Array, prior_mean: Array, prior_cov: Array, count: int
) -> list[Array]:
    """Return up to `count` motions (3,) that have most votes, of turns apart from one another, best first.

    mount: (5,) of the camera, see `twist_kernel.camera_moved`.
    """
    from localiser.visual_odometry import twist_kernel as kernel
    from localiser.visual_odometry import votes

    one, two = sights
    sigma = np.sqrt(np.diag(prior_cov))
    reach = min(_REACH * sigma[2], np.pi)
    bins = int(np.clip(2 * reach / _BIN_RAD, 3, _MOST_BINS)) | 1
    turns = prior_mean[2] + np.linspace(-reach, reach, bins)
    offset = np.stack(np.meshgrid(_GRID, _GRID), axis=-1).reshape(-1, 2) * _REACH * 0.8
    grid = prior_mean[:2] + offset * sigma[:2]
    cell = (_GRID[1] - _GRID[0]) * _REACH * 0.8 * sigma[:2] / 2
    moves = np.array([kernel.camera_moved(np.array([*step, 0.0]), mount)[:2] for step in grid])

    kernels = _kernels(turns[1] - turns[0])
    foot = one.inverse_range[pairs.first]
    foot = np.where(np.isnan(foot), two.inverse_range[pairs.second], foot)
    found = votes.votes(
        two.bearing[pairs.second],
        np.where(np.isnan(foot), TYPICAL_INVERSE_RANGE, foot),
        np.where(np.isnan(foot), TYPICAL_SPREAD, 0.2 * TYPICAL_SPREAD),
        one.bearing[pairs.first],
        pairs.look,
        moves,
        cell,
        turns[0],
        turns[1] - turns[0],
        bins,
        _WIDTHS_RAD,
        kernels,
        (kernels > 0).sum(axis=1),
    )
    found = found * np.exp(-0.5 * (offset**2).sum(axis=-1)[:, None] / 4)
    return [np.array([*grid[row], turns[column]]) for row, column in _peaks(found, turns, count)]


def _kernels(step: float) -> Array:
    """Return what a vote of each of W widths gives to the bins at 0, 1, 2 … from it (W, R); 0 beyond its reach."""
    sigma = np.maximum(_WIDTHS_RAD, step)[:, None]
    apart = np.arange(int(_KERNEL_REACH * sigma.max() / step) + 1) * step / sigma
    return np.where(apart < _KERNEL_REACH, np.exp(-0.5 * apart**2) / sigma, 0.0)


def _peaks(votes: Array, turns: Array, count: int) -> list[tuple[int, int]]:
    """Return (row, column) of the highest votes, at turns at least twice the narrowest width apart."""
    best = votes.max(axis=0)
    found: list[tuple[int, int]] = []
    apart = 4 * _WIDTHS_RAD[0]
    while len(found) < count and best.max() > 0:
        column = int(best.argmax())
        found.append((int(votes[:, column].argmax()), column))
        best = np.where(np.abs(turns - turns[column]) < apart, 0.0, best)
    return found
