"""Weighted particles: named columns, effective sample size, stages and kernel, estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localiser.geometry import Array, circular_mean, wrap_angle

POSE = ("x", "z", "heading")


@dataclass(frozen=True, slots=True, eq=False)
class Particles:
    """N weighted hypotheses.

    names: D column names, x, z, heading first, then biases. columns: (D, N), so that each column is contiguous.
    log_weight: (N,) natural logarithms, up to a common constant. circular: names of columns that are angles.
    """

    names: tuple[str, ...]
    columns: Array
    log_weight: Array
    circular: frozenset[str] = frozenset({"heading"})

    def __len__(self) -> int:
        return int(self.columns.shape[1])

    def __getitem__(self, name: str) -> Array:
        """Return the column (N,) of this name."""
        return np.asarray(self.columns[self.names.index(name)])

    @property
    def poses(self) -> Array:
        """Poses (N, 3) x, z, heading."""
        return np.stack([self[name] for name in POSE], axis=-1)

    @property
    def weight(self) -> Array:
        """Normalised weights (N,); raises ValueError when no particle has any."""
        return normalised(self.log_weight)


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
    def pose_cov(self) -> Array:
        """Covariance (3, 3) of the pose."""
        return self.cov[:3, :3]


def normalised(log_weight: Array) -> Array:
    """Return weights (N,) that sum to 1; raises ValueError when all are zero or one is nan."""
    top = log_weight.max(initial=-np.inf)
    if not np.isfinite(top):
        raise ValueError("no particle has a finite weight")
    weight = np.exp(log_weight - top)
    return np.asarray(weight / weight.sum())


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
    """Return the largest part of `share`, 0 … 1, of a log-likelihood (N,) that leaves `fewest` effective samples.

    Returns `share` itself where all of it does, 0 where no part does.
    """

    def enough(step: float) -> bool:
        return effective_sample_size(normalised(log_weight + step * log_likelihood)) >= fewest

    if enough(share):
        return share
    low, high = 0.0, share
    for _ in range(20):
        middle = (low + high) / 2
        low, high = (middle, high) if enough(middle) else (low, middle)
    return low


def kernel_width(particles: Particles) -> float:
    """Return the width h of each particle's kernel, as a share of the cloud's: N^(-1/(D+4)).

    About what is best for a normal density [Silverman 1986; Musso, Oudjane, Le Gland 2001].
    """
    dimensions, count = particles.columns.shape
    return float(count ** (-1.0 / (dimensions + 4)))


def spread(particles: Particles, rng: np.random.Generator) -> Particles:
    """Return equally weighted particles, each moved by a draw from a small kernel of the cloud's own shape.

    The kernel's covariance is h² times the cloud's, h from `kernel_width`. The cloud is first drawn together by
    √(1 - h²), so that its mean and covariance stay as they are [Liu, West 2001].
    """
    dimensions, count = particles.columns.shape
    width = kernel_width(particles)
    cloud = estimate(particles)
    variance, axes = np.linalg.eigh(cloud.cov)
    draws = axes @ (np.sqrt(np.maximum(variance, 0.0))[:, None] * rng.standard_normal((dimensions, count)))
    columns = np.empty_like(particles.columns)
    for row, name in enumerate(particles.names):
        circular = name in particles.circular
        residual = particles.columns[row] - cloud.mean[row]
        residual = wrap_angle(residual) if circular else residual
        column = cloud.mean[row] + np.sqrt(1.0 - width**2) * residual + width * draws[row]
        columns[row] = wrap_angle(column) if circular else column
    return replace(particles, columns=columns)


def take(particles: Particles, index: NDArray[np.int64]) -> Particles:
    """Return the particles at `index`, equally weighted."""
    return Particles(particles.names, particles.columns[:, index], np.zeros(len(index)), particles.circular)


def estimate(particles: Particles) -> Estimate:
    """Return the weighted mean and covariance over all columns; circular columns are averaged as directions."""
    weight = particles.weight
    mean = np.empty(len(particles.names))
    residual = np.empty_like(particles.columns)
    for row, name in enumerate(particles.names):
        column = particles.columns[row]
        if name in particles.circular:
            mean[row] = circular_mean(column, weight)
            residual[row] = wrap_angle(column - mean[row])
        else:
            mean[row] = weight @ column
            residual[row] = column - mean[row]
    return Estimate(particles.names, mean, np.asarray((residual * weight) @ residual.T))
