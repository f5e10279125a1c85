"""Clusters of weighted poses: the places where the robot may be, each with weight, mean and covariance.

Poses are put into a grid over x, z and heading. The heaviest cells that together hold the share `mass` of the weight
are the region of highest density; its connected parts (26 neighbours, the heading's circle closed) are the clusters.
Two of them are therefore apart by at least one cell of little weight, so a thin trail of particles joins nothing. The
cost grows as N log N with the particles, not with the space they are spread over. Nothing is random.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, wrap_angle

Indices = NDArray[np.int64]

# One of each pair of opposite neighbours: 13 of the 26.
_NEIGHBOURS = [step for step in product((-1, 0, 1), repeat=3) if step > (0, 0, 0)]


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
    poses: Array, weight: Array, *, cell_m: float = 0.25, cell_rad: float = np.pi / 18, mass: float = 0.95
) -> Clusters:
    """Return the clusters of poses (N, 3) with weight (N,), in cells of cell_m × cell_m × about cell_rad.

    weight: not negative, of any positive sum. mass: share of the weight, 0 … 1, that clusters hold at least. Raises
    ValueError when the weights' sum is zero or not finite, or a cell is not larger than zero.
    """
    total = float(np.sum(weight))
    if not np.isfinite(total) or total <= 0:
        raise ValueError(f"weights sum to {total}")
    if not (cell_m > 0 and cell_rad > 0):
        raise ValueError(f"cells of {cell_m} m and {cell_rad} rad")
    share = np.asarray(weight, dtype=np.float64) / total
    cells, cell_of_pose, around = _cells(poses, cell_m, cell_rad)
    dense = _densest(_sums(cell_of_pose, share), mass)
    part = np.full(len(cells), -1)
    part[dense] = _connected(cells[dense], around)
    return _summarised(np.asarray(poses, dtype=np.float64), share, part[cell_of_pose])


def poses_per_cell(poses: Array, cell_m: float = 0.25, cell_rad: float = np.pi / 18) -> Indices:
    """Return for each of the poses (N, 3) how many of them, itself included, lie in its cell."""
    cells, cell_of_pose, _ = _cells(poses, cell_m, cell_rad)
    return np.bincount(cell_of_pose, minlength=len(cells))[cell_of_pose]


def _cells(poses: Array, cell_m: float, cell_rad: float) -> tuple[Indices, Indices, int]:
    """Return the occupied cells (K, 3), the cell of each pose (N,), and how many cells close the heading's circle."""
    around = max(round(2 * np.pi / cell_rad), 1)
    place = np.floor(poses[:, :2] / cell_m).astype(np.int64)
    sector = np.floor(poses[:, 2] * (around / (2 * np.pi))).astype(np.int64) % around
    corner, extent = place.min(axis=0), np.ptp(place, axis=0) + 1
    column, row = (place - corner).T
    key, cell_of_pose = np.unique((column * extent[1] + row) * around + sector, return_inverse=True)
    cells = np.stack([key // around // extent[1], key // around % extent[1], key % around], axis=-1)
    return cells, cell_of_pose.ravel(), around


def _densest(weight: Array, mass: float) -> Indices:
    """Return the fewest cells, ascending, whose weight (K,), of sum 1, adds up to `mass`; none without weight."""
    heaviest = np.argsort(-weight, kind="stable")
    # Rounding must not let a cell of next to nothing in where all the others hold `mass` exactly.
    needed = np.searchsorted(np.cumsum(weight[heaviest]), mass - 1e-12) + 1
    dense = heaviest[:needed]
    return np.sort(dense[weight[dense] > 0])


def _connected(cells: Indices, around: int) -> Indices:
    """Return the label (K,) of each cell's connected part: the index of its first cell."""
    # A margin of one cell on each side, so that neighbours beyond the border have keys of their own.
    width = cells[:, 1].max() + 3

    def key_of(shifted: Indices) -> Indices:
        return np.asarray(((shifted[:, 0] + 1) * width + shifted[:, 1] + 1) * around + shifted[:, 2] % around)

    key = key_of(cells)  # ascending, as the cells are
    links = []
    for step in _NEIGHBOURS:
        wanted = key_of(cells + np.array(step))
        found = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        touches = np.flatnonzero(key[found] == wanted)
        links.append(np.stack([touches, found[touches]]))
    return _components(len(cells), np.concatenate(links, axis=1))


def _components(count: int, links: Indices) -> Indices:
    """Return for each of `count` nodes the lowest node that the links (2, M) connect it to."""
    label = np.arange(count)
    while True:
        ends = label[links]
        lowest = label.copy()
        # Hang the root of either end below the lower one, then point every node at its root.
        np.minimum.at(lowest, ends.ravel(), np.tile(ends.min(axis=0), 2))
        while (lowest[lowest] != lowest).any():
            lowest = lowest[lowest]
        if np.array_equal(lowest, label):
            return label
        label = lowest


def _sums(index: Indices, value: Array) -> Array:
    """Return the sum of values (N,) over each index (N,)."""
    return np.asarray(np.bincount(index, value), dtype=np.float64)


def _summarised(poses: Array, share: Array, part: Indices) -> Clusters:
    """Return weight, mean and covariance of the poses (N, 3) with the same part (N,) ≥ 0, heaviest first."""
    inside = np.flatnonzero(part >= 0)
    _, index = np.unique(part[inside], return_inverse=True)
    index = index.ravel()
    weight = _sums(index, share[inside])
    order = np.argsort(-weight, kind="stable")
    rank = np.argsort(order)
    label = np.full(len(poses), -1)
    label[inside] = rank[index]
    weight, index = weight[order], rank[index]

    def mean_of(value: Array) -> Array:
        return _sums(index, share[inside] * value) / weight

    x, z, heading = poses[inside].T
    mean = np.stack([mean_of(x), mean_of(z), np.arctan2(mean_of(np.sin(heading)), mean_of(np.cos(heading)))], axis=-1)
    error = poses[inside] - mean[index]
    error[:, 2] = wrap_angle(error[:, 2])
    cov = np.array([[mean_of(error[:, row] * error[:, column]) for row in range(3)] for column in range(3)])
    return Clusters(weight, mean, cov.transpose(2, 0, 1), np.bincount(index), label)
