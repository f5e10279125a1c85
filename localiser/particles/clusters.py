"""Clusters of weighted poses: the places where the robot may be, each with weight, mean and covariance.

Poses are put into a grid over x, z and heading. The heaviest cells that together hold the share `mass` of the weight
are the region of highest density; its connected parts (26 neighbours, the heading's circle closed) are the clusters.
So a thin trail of particles joins nothing. The cost grows as N log N with the particles, not with the space. Nothing is
random.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, cos_sin, wrap_angle

Indices = NDArray[np.int64]

CELL_M, CELL_RAD = 0.25, np.pi / 18

# One of each pair of opposite neighbours: 13 of the 26.
_NEIGHBOURS = np.array([step for step in product((-1, 0, 1), repeat=3) if step > (0, 0, 0)])

_TABLE_PER_POSE = 8  # cells of the whole box, up to which a table of them is quicker than to sort


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """C clusters of N weighted poses, heaviest first.

    weight: (C,) share of the whole weight; what they leave of 1 lies outside all clusters. mean: (C, 3) x, z, heading.
    cov: (C, 3, 3) about it. count: (C,) poses in each. label: (N,) the cluster of every pose, -1 for none.
    """

    weight: Array
    mean: Array
    cov: Array
    count: Indices
    label: Indices

    def __len__(self) -> int:
        return len(self.weight)

    def heaviest(self, fewest: float) -> Clusters:
        """Return the clusters with at least this weight; poses of the others belong to none."""
        kept = int((self.weight >= fewest).sum())
        label = np.where(self.label < kept, self.label, -1)
        return Clusters(self.weight[:kept], self.mean[:kept], self.cov[:kept], self.count[:kept], label)

    def beside(self, others: Clusters, share: float) -> Clusters:
        """Return both, heaviest first: the others with this share, 0 … 1, of the whole weight. No pose is labelled."""
        weight = np.concatenate([(1.0 - share) * self.weight, share * others.weight])
        order = np.argsort(-weight, kind="stable")
        mean, cov = np.concatenate([self.mean, others.mean]), np.concatenate([self.cov, others.cov])
        count = np.concatenate([self.count, others.count])
        return Clusters(weight[order], mean[order], cov[order], count[order], np.full(0, -1))


def find_clusters(
    poses: Array, weight: Array, *, cell_m: float = CELL_M, cell_rad: float = CELL_RAD, mass: float = 0.95
) -> Clusters:
    """Return the clusters of poses (N, 3) with weight (N,), in cells of cell_m × cell_m × about cell_rad.

    weight: not negative. mass: share of the weight, 0 … 1, that clusters hold at least. Raises ValueError when the
    weights' sum is zero or not finite, or a cell is not larger than zero.
    """
    total = float(np.sum(weight))
    if not np.isfinite(total) or total <= 0:
        raise ValueError(f"weights sum to {total}")
    share, poses = np.asarray(weight, dtype=np.float64) / total, np.asarray(poses, dtype=np.float64)
    if (np.ptp(poses, axis=0) < [cell_m, cell_m, cell_rad]).all():  # no larger than a cell, as while a place is tracked
        return _summarised(poses, share, np.zeros(len(poses), dtype=np.int64))
    cells, cell_of_pose, around = _cells(poses, cell_m, cell_rad)
    dense = _densest(np.asarray(np.bincount(cell_of_pose, share), dtype=np.float64), mass)
    part = np.full(len(cells), -1)
    part[dense] = _connected(cells[dense], around)
    return _summarised(poses, share, part[cell_of_pose])


def cells_of(poses: Array, cell_m: float = CELL_M, cell_rad: float = CELL_RAD) -> Indices:
    """Return for each of the poses (N, 3) which of the occupied cells, from 0 on, it lies in."""
    return _cells(poses, cell_m, cell_rad)[1]


def _cells(poses: Array, cell_m: float, cell_rad: float) -> tuple[Indices, Indices, int]:
    """Return the occupied cells (K, 3), the cell of each pose (N,), and how many cells close the heading's circle."""
    if not (cell_m > 0 and cell_rad > 0):
        raise ValueError(f"cells of {cell_m} m and {cell_rad} rad")
    around = max(round(2 * np.pi / cell_rad), 1)
    column, row = np.floor(poses[:, :2].T.copy() / cell_m).astype(np.int64)
    sector = np.floor(poses[:, 2] * (around / (2 * np.pi))).astype(np.int64) % around
    column, row = column - column.min(), row - row.min()
    columns, rows = int(column.max()) + 1, int(row.max()) + 1
    key, cell_of_pose = _occupied((column * rows + row) * around + sector, columns * rows * around)
    cells = np.stack([key // around // rows, key // around % rows, key % around], axis=-1)
    return cells, cell_of_pose, around


def _occupied(key: Indices, keys: int) -> tuple[Indices, Indices]:
    """Return which of so many keys occur (K,), ascending, and which of these each of `key` (N,) is."""
    if keys > _TABLE_PER_POSE * len(key):
        occupied, index = np.unique(key, return_inverse=True)
        return occupied, index.ravel()
    occurs = np.zeros(keys, dtype=bool)
    occurs[key] = True
    return np.flatnonzero(occurs), (np.cumsum(occurs) - 1)[key]


def _densest(weight: Array, mass: float) -> Indices:
    """Return the fewest cells, ascending, whose weight (K,), of sum 1, adds up to `mass`; none without weight."""
    heaviest = np.argsort(-weight, kind="stable")
    # Rounding must not let a cell of next to nothing in where all the others hold `mass` exactly.
    needed = np.searchsorted(np.cumsum(weight[heaviest]), mass - 1e-12) + 1
    dense = heaviest[:needed]
    return np.sort(dense[weight[dense] > 0])


def _connected(cells: Indices, around: int) -> Indices:
    """Return the connected part (K,) of each cell, numbered from 0 in the order of their first cells."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    # A margin of one cell on each side, so that neighbours beyond the border have keys of their own.
    width = cells[:, 1].max() + 3

    def key_of(shifted: Indices) -> Indices:
        column, row, sector = np.moveaxis(shifted, -1, 0)
        return np.asarray(((column + 1) * width + row + 1) * around + sector % around)

    key = key_of(cells)  # ascending, as the cells are
    wanted = key_of(cells + _NEIGHBOURS[:, None])
    found = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
    neighbour, touches = np.nonzero(key[found] == wanted)
    links = csr_array((np.ones(len(touches)), (touches, found[neighbour, touches])), (len(cells), len(cells)))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def _summarised(poses: Array, share: Array, part: Indices) -> Clusters:
    """Return weight, mean and covariance of the poses (N, 3) with the same part (N,) ≥ 0, heaviest first."""
    inside = np.argsort(part, kind="stable")[np.count_nonzero(part < 0) :]
    first = np.flatnonzero(np.diff(part[inside], prepend=-1))  # of each part, whose poses follow each other
    count = np.diff(first, append=len(inside))
    share = share[inside]
    x, z, heading = poses[inside].T.copy()
    sums = np.add.reduceat(share * [np.ones_like(x), x, z, *cos_sin(heading)], first, axis=1)
    weight = sums[0]
    mean_x, mean_z, cos, sin = sums[1:] / weight
    mean = np.stack([mean_x, mean_z, np.arctan2(sin, cos)], axis=-1)
    dx, dz, turn = np.array([x, z, heading]) - np.repeat(mean.T, count, axis=1)
    turn = wrap_angle(turn)
    xx, xz, xt, zz, zt, tt = (
        np.add.reduceat(share * [dx * dx, dx * dz, dx * turn, dz * dz, dz * turn, turn * turn], first, axis=1) / weight
    )
    cov = np.array([[xx, xz, xt], [xz, zz, zt], [xt, zt, tt]]).transpose(2, 0, 1)

    order = np.argsort(-weight, kind="stable")
    label = np.full(len(poses), -1)
    label[inside] = np.repeat(np.argsort(order), count)
    return Clusters(weight[order], mean[order], cov[order], count[order], label)
