"""Weighted particles: named columns, effective sample size, stages and kernel, estimate, resampling, clusters.

Clusters are the places where the robot may be. Poses are put into a grid over x, z and heading. The heaviest cells that
together hold the share `mass` of the weight are the region of highest density; its connected parts (26 neighbours, the
heading's circle closed) are the clusters. So a thin trail of particles joins nothing. The cost grows as N log N with
the particles, not with the space. Nothing is random.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, Indices, cos_sin, wrap_angle

POSE = ("x", "z", "heading")
CAMERA_YAW = "camera_yaw"
MOST_STAGES = 12  # of resampling in one frame, so that it takes a bounded time whatever it shows
CELL_M, CELL_RAD = 0.25, np.pi / 18
ADDED = 10_000  # products at a time: of more, BLAS adds parts in as many threads as it has
_AROUND = round(2 * np.pi / CELL_RAD)  # cells that close the heading's circle
# One of each pair of opposite neighbours: 13 of the 26.
_NEIGHBOURS = np.array([step for step in product((-1, 0, 1), repeat=3) if step > (0, 0, 0)])


@dataclass(frozen=True, eq=False)
class Particles:
    """N weighted hypotheses.

    names: D column names, x, z, heading first, then B constant errors. columns: (D, N), each contiguous. log_weight:
    (N,) natural logarithms, up to a common constant. constant_error_cov: (B, B) of the constant errors within each
    particle, of which the columns are the mean of a normal density; empty where none is in doubt. The camera's yaw
    widens the heading.
    """

    names: tuple[str, ...]
    columns: Array
    log_weight: Array
    constant_error_cov: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def __len__(self) -> int:
        return int(self.columns.shape[1])

    def __getitem__(self, name: str) -> Array:
        """Return the column (N,) of this name."""
        return np.asarray(self.columns[self.names.index(name)])

    @property
    def poses(self) -> Array:
        """Poses (N, 3) x, z, heading."""
        return np.ascontiguousarray(self.columns[:3].T)

    @cached_property
    def weight(self) -> Array:
        """Normalised weights (N,); raises ValueError when no particle has any."""
        return normalised(self.log_weight)

    @cached_property
    def estimate(self) -> Estimate:
        """The weighted mean and covariance over all columns; the headings are averaged as directions.

        The covariance is that between the particles and, of the constant errors, that within each.
        """
        mean, residual = centred(self.columns, self.weight)
        cov = np.asarray((residual * self.weight) @ residual.T)
        if self.constant_error_cov.any():
            # Within each particle the camera is where it is, not so the robot.
            by_constant_error = np.eye(len(self.names))[:, len(POSE) :]
            if CAMERA_YAW in self.names:
                by_constant_error[2] = -by_constant_error[self.names.index(CAMERA_YAW)]
            cov += np.asarray(by_constant_error @ self.constant_error_cov @ by_constant_error.T)
        return Estimate(self.names, mean, cov)

    @cached_property
    def clusters(self) -> Clusters:
        """The places where the robot may be."""
        return find_clusters(self.poses, self.weight)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Weighted mean and covariance of particles: names (D), mean (D,), cov (D, D); pose columns first."""

    names: tuple[str, ...]
    mean: Array
    cov: Array

    @property
    def pose(self) -> Array:
        """Mean pose (3,) x, z, heading."""
        return self.mean[:3]

    @property
    def as_seen(self) -> Estimate:
        """The pose of the robot from where a camera without a yaw of its own sees the same."""
        turned = np.eye(3, len(self.names))
        turned[2] += [name == CAMERA_YAW for name in self.names]
        return Estimate(POSE, turned @ self.mean, turned @ self.cov @ turned.T)

    @property
    def pose_cov(self) -> Array:
        """Covariance (3, 3) of the pose."""
        return self.cov[:3, :3]


def normalised(log_weight: Array) -> Array:
    """Return weights (N,) that sum to 1; raises ValueError when all are zero or one is nan."""
    top = float(log_weight.max(initial=-np.inf))
    if not math.isfinite(top):
        raise ValueError("no particle has a finite weight")
    weight = np.exp(log_weight - top)
    return np.asarray(weight / weight.sum())


def log_sum(log_weight: Array) -> float:
    """Return log Σ exp(log_weight) of (N,), -inf where no particle has any: faster than `np.logaddexp.reduce`."""
    top = float(log_weight.max(initial=-np.inf))
    if not math.isfinite(top):
        return top
    return float(top + np.log(np.exp(log_weight - top).sum()))


def from_gaussian(mean: Array, cov: Array, count: int, rng: np.random.Generator) -> Particles:
    """Return `count` equally weighted particles drawn from N(mean, cov) over (x, z, heading)."""
    # Draw through the eigenvectors: also right where the covariance is singular (a start that is known exactly).
    variance, axes = np.linalg.eigh(cov)
    draws = rng.standard_normal((count, 3)) * np.sqrt(np.maximum(variance, 0.0))
    columns = (mean + draws @ axes.T).T.copy()
    columns[2] = wrap_angle(columns[2])
    return Particles(POSE, columns, np.zeros(count))


def effective_sample_size(weight: Array) -> float:
    """Return 1 / Σ w² of normalised weights (N,): N when all are equal, 1 when one has all."""
    return float(1.0 / np.square(weight).sum())


def largest_step(log_weight: Array, log_likelihood: Array, share: float, fewest: float) -> float:
    """Return the largest part of `share`, 0 … 1, of a log-likelihood (N,) that leaves `fewest` effective samples."""

    def enough(step: float) -> bool:
        return effective_sample_size(normalised(log_weight + step * log_likelihood)) >= fewest

    if enough(share):
        return share
    low, high = 0.0, share
    for _ in range(20):
        middle = (low + high) / 2
        low, high = (middle, high) if enough(middle) else (low, middle)
    return low


def spread(particles: Particles, rng: np.random.Generator) -> Particles:
    """Return equally weighted particles, each moved by a draw from a small kernel of the cloud's own shape.

    The kernel's covariance is h² times the cloud's. The cloud is first drawn together by √(1 - h²), so that its mean
    and covariance stay as they are [Liu, West 2001]. h = N^(-1/7) is about what is best for a normal density of three
    dimensions: poses, since constant errors follow from their paths [Silverman 1986; Musso, Oudjane, Le Gland 2001].
    """
    width = float(len(particles) ** (-1.0 / (len(POSE) + 4)))
    mean, residual = centred(particles.columns, particles.weight)
    variance, axes = np.linalg.eigh((residual * particles.weight) @ residual.T)
    draws = axes @ (np.sqrt(np.maximum(variance, 0.0))[:, None] * rng.standard_normal(residual.shape))
    columns = mean[:, None] + np.sqrt(1.0 - width**2) * residual + width * draws
    columns[2] = wrap_angle(columns[2])
    return replace(particles, columns=columns)


def take(particles: Particles, index: Indices) -> Particles:
    """Return the particles at `index`, equally weighted."""
    return replace(particles, columns=np.take(particles.columns, index, axis=1), log_weight=np.zeros(len(index)))


def only(particles: Particles, chosen: NDArray[np.bool_] | slice) -> Particles:
    """Return the chosen (N,) of the particles, with their weights."""
    return replace(particles, columns=particles.columns[:, chosen], log_weight=particles.log_weight[chosen])


def thinned(particles: Particles, count: int) -> Particles:
    """Return every k-th of the particles, with its weight: at most `count` of them."""
    return only(particles, slice(None, None, -(-len(particles) // count)))


def centred(columns: Array, weight: Array) -> tuple[Array, Array]:
    """Return the mean (D,) of particles (D, N) of weight (N,), and what each is off it (D, N)."""
    parts = [slice(first, first + ADDED) for first in range(0, len(weight), ADDED)]
    mean = np.sum([(columns[:, None, part] @ weight[part, None]).ravel() for part in parts], axis=0)
    cos, sin = cos_sin(columns[2])
    mean[2] = np.arctan2(*np.sum([(weight[part] @ sin[part], weight[part] @ cos[part]) for part in parts], axis=0))
    residual = columns - mean[:, None]
    residual[2] = wrap_angle(residual[2])
    return mean, residual


# -- resampling: on average as many offspring as the weight says ------------------------------------------------------


def systematic_resample(weight: Array, count: int, rng: np.random.Generator) -> Indices:
    """Return `count` indices from an even comb with one uniform offset: offspring are ⌊count·w⌋ or ⌈count·w⌉.

    weight: (N,) not negative, of any positive sum. Raises ValueError when the sum is zero or not finite, or a weight is
    negative. [Carpenter, Clifford, Fearnhead 1999]
    """
    offset = rng.random()
    cumulative, last = _cumulative(weight)
    place = cumulative * (count / cumulative[-1])
    whole = np.minimum(place.astype(np.int64), count - 1)
    # Teeth of the comb below `place`: all at whole numbers before, and the next one if it comes first.
    below = whole + (offset < place - whole)
    below[last:] = count
    return np.repeat(np.arange(len(below)), np.diff(below, prepend=0))


def multinomial_resample(weight: Array, count: int, rng: np.random.Generator) -> Indices:
    """Return `count` ascending indices drawn independently [Gordon, Salmond, Smith 1993]; weight, errors: as above."""
    cumulative, last = _cumulative(weight)
    drawn = np.sort(rng.random(count)) * cumulative[-1]
    return np.asarray(np.minimum(np.searchsorted(cumulative, drawn, side="right"), last))


def _cumulative(weight: Array) -> tuple[Array, int]:
    """Return the cumulative sum (N,) and the index of the last particle that has any weight; checks the weights."""
    cumulative = np.cumsum(weight, dtype=np.float64)
    total = cumulative[-1] if len(cumulative) else 0.0
    if not np.isfinite(total) or total <= 0:
        raise ValueError(f"weights sum to {total}")
    if np.min(weight) < 0:
        raise ValueError(f"weight {np.min(weight)} is negative")
    return cumulative, int(np.flatnonzero(weight)[-1])


# -- clusters: the places where the robot may be, each with weight, mean and covariance -------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """C clusters of N weighted poses, heaviest first.

    weight: (C,) share of the whole weight; what they leave of 1 lies outside all clusters. mean: (C, 3) x, z, heading.
    cov: (C, 3, 3) about it. label: (N,) the cluster of every pose, -1 for none.
    """

    weight: Array
    mean: Array
    cov: Array
    label: Indices

    def __len__(self) -> int:
        return len(self.weight)

    def beside(self, others: Clusters, share: float) -> Clusters:
        """Return both, heaviest first: the others with this share, 0 … 1, of the whole weight. No pose is labelled."""
        weight = np.concatenate([(1.0 - share) * self.weight, share * others.weight])
        order = np.argsort(-weight, kind="stable")
        mean, cov = np.concatenate([self.mean, others.mean]), np.concatenate([self.cov, others.cov])
        return Clusters(weight[order], mean[order], cov[order], np.full(0, -1))


def find_clusters(poses: Array, weight: Array, *, mass: float = 0.95) -> Clusters:
    """Return the clusters of poses (N, 3) with weight (N,), in cells of `CELL_M` × `CELL_M` × `CELL_RAD`.

    weight: not negative. mass: share of the weight, 0 … 1, that clusters hold at least. Raises ValueError when the
    weights' sum is zero or not finite.
    """
    total = float(np.sum(weight))
    if not np.isfinite(total) or total <= 0:
        raise ValueError(f"weights sum to {total}")
    share = weight / total
    if (np.ptp(poses.T.copy(), axis=1) < [CELL_M, CELL_M, CELL_RAD]).all():  # as while a place is tracked
        return _summarised(poses, share, np.zeros(len(poses), dtype=np.int64))
    cells, cell_of_pose = _cells(poses)
    # The fewest cells whose weight adds up to `mass`. Rounding must not let a cell of next to nothing in where all the
    # others hold it exactly.
    cell_weight = np.bincount(cell_of_pose, share)
    by_weight = np.argsort(-cell_weight, kind="stable")
    dense = by_weight[: np.searchsorted(np.cumsum(cell_weight[by_weight]), mass - 1e-12) + 1]
    dense = np.sort(dense[cell_weight[dense] > 0])
    part = np.full(len(cells), -1)
    part[dense] = _connected(cells[dense])
    return _summarised(poses, share, part[cell_of_pose])


def cells_of(poses: Array) -> Indices:
    """Return for each of the poses (N, 3) which of the occupied cells, from 0 on, it lies in."""
    return _cells(poses)[1]


def _cells(poses: Array) -> tuple[Indices, Indices]:
    """Return the occupied cells (K, 3), and the cell of each pose (N,)."""
    column, row = np.floor(poses[:, :2].T.copy() / CELL_M).astype(np.int64)
    sector = np.floor(poses[:, 2] * (_AROUND / (2 * np.pi))).astype(np.int64) % _AROUND
    column, row = column - column.min(), row - row.min()
    rows = int(row.max()) + 1
    key, cell_of_pose = np.unique((column * rows + row) * _AROUND + sector, return_inverse=True)
    return np.stack([key // _AROUND // rows, key // _AROUND % rows, key % _AROUND], axis=-1), cell_of_pose


def _connected(cells: Indices) -> Indices:
    """Return the connected part (K,) of each cell, numbered from 0 in the order of their first cells."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    # A margin of one cell on each side, so that neighbours beyond the border have keys of their own.
    width = cells[:, 1].max() + 3

    def key_of(shifted: Indices) -> Indices:
        column, row, sector = np.moveaxis(shifted, -1, 0)
        return np.asarray(((column + 1) * width + row + 1) * _AROUND + sector % _AROUND)

    key = key_of(cells)  # ascending, as the cells are
    wanted = key_of(cells + _NEIGHBOURS[:, None])
    found = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
    neighbour, touches = np.nonzero(key[found] == wanted)
    links = csr_array((np.ones(len(touches)), (touches, found[neighbour, touches])), (len(cells), len(cells)))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def _summarised(poses: Array, share: Array, part: Indices) -> Clusters:
    """Return weight, mean and covariance of the poses (N, 3) with the same part (N,) ≥ 0, heaviest first."""
    inside = np.argsort(part, kind="stable")[np.count_nonzero(part < 0) :]
    count = np.bincount(part[inside])
    first = np.cumsum(count) - count  # of each part, whose poses follow each other
    share, columns = share[inside], np.take(poses.T, inside, axis=1)
    sums = np.add.reduceat(share * [np.ones_like(share), *columns[:2], *cos_sin(columns[2])], first, axis=1)
    weight = sums[0]
    x, z, cos, sin = sums[1:] / weight
    mean = np.array([x, z, np.arctan2(sin, cos)])
    off = columns - np.repeat(mean, count, axis=1)
    off[2] = wrap_angle(off[2])
    cov = np.add.reduceat(share * (off[:, None] * off), first, axis=2) / weight

    order = np.argsort(-weight, kind="stable")
    label = np.full(len(poses), -1)
    label[inside] = np.repeat(np.argsort(order), count)
    return Clusters(weight[order], mean.T[order], cov.transpose(2, 0, 1)[order], label)
