"""A motion with its covariance, and the path that led to it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from localiser.geometry.angles import Array
from localiser.geometry.poses import compose


@dataclass(frozen=True, slots=True, eq=False)
class Increment:
    """A motion of the robot between two instants, from wheels or from vision.

    mean: (3,) motion (right m, backward m, turn rad) in the robot frame at the first instant.
    cov: (3, 3) covariance of `mean`; zeros leave the noise to the motion model.
    path_m, turned_rad: how far the robot drove and turned on the way, which is more than `mean` where it went to and
        fro; the motion model's noise grows with these.
    by_delay: (3,) how `mean` changes per second by which the robot is later than its odometry.
    """

    mean: Array
    cov: Array
    path_m: float
    turned_rad: float
    by_delay: Array = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def from_mean(cls, mean: ArrayLike, cov: ArrayLike | None = None) -> Increment:
        """Return the increment of one straight move: path and turn are those of `mean` (3,)."""
        mean = np.asarray(mean, dtype=np.float64)
        cov = np.zeros((3, 3)) if cov is None else np.asarray(cov, dtype=np.float64)
        return cls(mean, cov, float(np.hypot(mean[0], mean[1])), float(abs(mean[2])))

    def then(self, later: Increment) -> Increment:
        """Return this motion followed by `later`; covariances are carried to first order.

        cov = A cov_1 Aᵀ + B cov_2 Bᵀ with A = ∂(1 ∘ 2)/∂1 and B = ∂(1 ∘ 2)/∂2 [Smith, Self, Cheeseman 1990].
        """
        cos, sin = np.cos(self.mean[2]), np.sin(self.mean[2])
        x, z = later.mean[0], later.mean[1]
        jac_self = np.array([[1.0, 0.0, -sin * x + cos * z], [0.0, 1.0, -cos * x - sin * z], [0.0, 0.0, 1.0]])
        jac_later = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        cov = jac_self @ self.cov @ jac_self.T + jac_later @ later.cov @ jac_later.T
        return Increment(
            compose(self.mean, later.mean),
            cov,
            self.path_m + later.path_m,
            self.turned_rad + later.turned_rad,
            jac_self @ self.by_delay + jac_later @ later.by_delay,
        )
