"""Proposal density: a mixture of Gaussians over poses, to draw particles with exact weights from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.geometry import Array, wrap_angle

NEAR_M2_RAD = np.pi * 0.3**2 * np.radians(12.0)  # of the poses within 0.3 m and 6° of one


@dataclass(frozen=True, slots=True)
class Region:
    """Where the robot may be before anything is seen: every point of a rectangle and every heading alike.

    x_m, z_m: lowest and highest coordinate.
    """

    x_m: tuple[float, float]
    z_m: tuple[float, float]

    @classmethod
    def around(cls, points: Array, margin_m: float) -> Region:
        """Return the rectangle around points (L, 2), wider by a margin on every side."""
        low, high = points.min(axis=0) - margin_m, points.max(axis=0) + margin_m
        return cls((float(low[0]), float(high[0])), (float(low[1]), float(high[1])))

    @property
    def log_density(self) -> float:
        """Logarithm of the prior density inside, per m² rad."""
        area = (self.x_m[1] - self.x_m[0]) * (self.z_m[1] - self.z_m[0])
        return float(-np.log(area * 2 * np.pi))

    def contains(self, poses: Array) -> Array:
        """Return which of the poses (N, 3) lie inside."""
        x, z = poses[:, 0], poses[:, 1]
        return np.asarray((x >= self.x_m[0]) & (x <= self.x_m[1]) & (z >= self.z_m[0]) & (z <= self.z_m[1]))

    def drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Return poses (count, 3) drawn evenly."""
        low, high = [self.x_m[0], self.z_m[0], -np.pi], [self.x_m[1], self.z_m[1], np.pi]
        return rng.uniform(low, high, (count, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Proposals:
    """A density over poses: C Gaussians, and an even share over the region that keeps every weight bounded.

        q(x) = (1 - even) Σ_c π_c N(x; mean_c, cov_c) + even / volume

    log_weight: (C,) log π_c, of sum 1, most likely first. mean: (C, 3) x, z, heading; cov: (C, 3, 3). even: 0 … 1, and
    1 where there is no component. hits: how many of the poses that were tried for the Gaussians are expected to be the
    true one.
    """

    log_weight: Array
    mean: Array
    cov: Array
    region: Region
    even: float
    hits: float = 0.0

    def __len__(self) -> int:
        return len(self.log_weight)

    @classmethod
    def blind(cls, region: Region) -> Proposals:
        """Return the density that knows nothing: even over the region."""
        return cls(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)), region, even=1.0)

    def expected_hits(self, count: int) -> float:
        """Return how many poses are expected to be near the true one: of those tried, and of `count` even draws."""
        return float(self.hits + self.even * count * NEAR_M2_RAD * np.exp(self.region.log_density))

    def drawn(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return poses (count, 3) drawn from q and their importance weights log(prior / q) (count,).

        Adding the log-likelihood of the edges makes them weighted draws from the posterior under the prior that the
        region states; -inf outside it.
        """
        poses = self.region.drawn(count, rng)
        chosen = np.flatnonzero(rng.random(count) >= self.even) if len(self) else np.zeros(0, dtype=np.int64)
        if len(chosen):
            component = rng.choice(len(self), size=len(chosen), p=np.exp(self.log_weight))
            steps = rng.standard_normal((len(chosen), 3, 1))
            drawn = self.mean[component] + (np.linalg.cholesky(self.cov)[component] @ steps)[..., 0]
            drawn[:, 2] = wrap_angle(drawn[:, 2])
            poses[chosen] = drawn
        inside = self.region.contains(poses)
        return poses, np.where(inside, self.region.log_density, -np.inf) - self.log_density(poses)

    def log_density(self, poses: Array) -> Array:
        """Return log q (N,) at poses (N, 3), per m² rad.

        Headings are compared the short way round, which is exact while all components are narrow compared with 2π.
        """
        even = np.log(max(self.even, 1e-300)) + self.region.log_density
        result = np.where(self.region.contains(poses), even, -np.inf)
        roots = np.linalg.inv(np.linalg.cholesky(self.cov)) if len(self) else np.zeros((0, 3, 3))
        log_peak = self.log_weight - 1.5 * np.log(2 * np.pi) + np.log(np.linalg.det(roots))
        for weight, mean, root in zip(log_peak + np.log1p(-min(self.even, 1 - 1e-16)), self.mean, roots, strict=True):
            error = poses - mean
            error[:, 2] = wrap_angle(error[:, 2])
            result = np.logaddexp(result, weight - 0.5 * ((error @ root.T) ** 2).sum(axis=1))
        return np.asarray(result)
