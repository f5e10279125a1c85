"""Where to start: turns that many pairs of edges agree on, for a coarse grid of ways the robot may have moved.

A pair votes for the turn that is left of its change of bearing once the parallax of a supposed translation is taken
off; the vote is as blurred as its range and the grid leave it uncertain. A Hough transform, in other words.
"""

from __future__ import annotations

import numpy as np

from localiser.camera import Camera
from localiser.geometry import Array, wrap_angle
from localiser.increments.pairs import TYPICAL_INVERSE_RANGE, TYPICAL_SPREAD, Pairs
from localiser.increments.views import Sights, camera_motion

_REACH = 2.5  # sigmas of the prior that are searched
_BIN_RAD = np.deg2rad(0.25)
_WIDTHS_RAD = np.deg2rad([0.3, 0.6, 1.2, 2.4, 4.8])
_GRID = np.linspace(-1.0, 1.0, 7)
_MOST_BINS = 1440
_KERNEL_REACH = 5.0  # sigmas; also keeps numbers so small that they are slow out of the sums


def likely_motions(
    pairs: Pairs, sights: tuple[Sights, Sights], camera: Camera, prior_cov: Array, count: int
) -> list[Array]:
    """Return up to `count` motions (3,) that have most votes, of turns apart from one another, best first."""
    one, two = sights
    sigma = np.sqrt(np.diag(prior_cov))
    reach = min(_REACH * sigma[2], np.pi)
    bins = int(np.clip(2 * reach / _BIN_RAD, 3, _MOST_BINS)) | 1
    turns = np.linspace(-reach, reach, bins)
    grid = np.stack(np.meshgrid(_GRID, _GRID), axis=-1).reshape(-1, 2) * _REACH * 0.8 * sigma[:2]
    cell = (_GRID[1] - _GRID[0]) * _REACH * 0.8 * sigma[:2] / 2

    foot = one.inverse_range[pairs.first]
    foot = np.where(np.isnan(foot), two.inverse_range[pairs.second], foot)
    inverse = np.where(np.isnan(foot), TYPICAL_INVERSE_RANGE, foot)
    spread = np.where(np.isnan(foot), TYPICAL_SPREAD, 0.2 * TYPICAL_SPREAD)
    bearing = one.bearing[pairs.first]
    ray = np.stack([np.sin(bearing), -np.cos(bearing)], axis=-1)
    across = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)

    offsets, widths = [], []
    for step in grid:
        moved, _ = camera_motion(np.array([*step, 0.0]), camera)
        d = ray - inverse[:, None] * moved[:2]
        offsets.append(wrap_angle(two.bearing[pairs.second] - np.arctan2(d[:, 0], -d[:, 1])))
        by_cell = inverse * np.hypot(*(across * cell).T) / 2
        widths.append(np.hypot(spread * np.abs(across @ moved[:2]), by_cell))
    votes = _votes(np.array(offsets), np.array(widths), pairs.look, turns)
    votes = votes * np.exp(-0.5 * ((grid / sigma[:2]) ** 2).sum(axis=-1)[:, None] / 4)
    return [np.array([*grid[row], turns[column]]) for row, column in _peaks(votes, turns, count)]


def _votes(offset: Array, width: Array, look: Array, turns: Array) -> Array:
    """Return the votes (G, B) for each turn (B,) under each translation (G): offset, width (G, P), rad."""
    rows, count = offset.shape
    bins, step = len(turns), turns[1] - turns[0]
    kind = np.searchsorted(_WIDTHS_RAD, width).clip(0, len(_WIDTHS_RAD) - 1)
    column = np.rint((offset - turns[0]) / step).astype(np.int64)
    inside = (column >= 0) & (column < bins)
    place = (np.arange(rows)[:, None] * len(_WIDTHS_RAD) + kind) * bins + column
    flat = np.bincount(
        place[inside], np.broadcast_to(look, (rows, count))[inside], minlength=rows * len(_WIDTHS_RAD) * bins
    ).reshape(rows, len(_WIDTHS_RAD), bins)
    total = np.zeros((rows, bins))
    for index, sigma in enumerate(np.maximum(_WIDTHS_RAD, step)):
        apart = np.abs(turns[:, None] - turns) / sigma
        kernel = np.where(apart < _KERNEL_REACH, np.exp(-0.5 * np.minimum(apart, _KERNEL_REACH) ** 2) / sigma, 0.0)
        total += flat[:, index] @ kernel
    return total


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
