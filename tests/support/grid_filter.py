"""A histogram filter over (x, z, heading): the oracle of the particle filter in a small world.

Plain and exact up to its grid; nothing is sampled. [Thrun, Burgard, Fox 2005, table 8.1]

    grid = GridFilter.gaussian(x, z, heading, mean, cov)
    grid = grid.predict(increment, noise_cov)
    grid = grid.update(log_likelihood)
    grid.mean, grid.cov
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from localiser.geometry import Array, Increment, wrap_angle

NARROWEST_SIGMA_CELLS = 0.6  # a Gaussian narrower than this is no longer sampled faithfully by the cells' centres
BORDER_MASS = 1e-6


def headings(count: int) -> Array:
    """Return the centres (H,) of `count` cells around the full circle."""
    return np.arange(count) * (2 * np.pi / count) - np.pi


@dataclass(frozen=True, slots=True, eq=False)
class GridFilter:
    """Probability of every cell: p (X, Z, H) over the centres x (X,), z (Z,) in m and heading (H,) from `headings`."""

    x: Array
    z: Array
    heading: Array
    p: Array

    @classmethod
    def gaussian(cls, x: Array, z: Array, heading: Array, mean: Array, cov: Array) -> "GridFilter":
        """Return N(mean (3,), cov (3, 3)) on these axes, the heading wrapped."""
        grid = cls(x, z, heading, np.full((len(x), len(z), len(heading)), 1.0 / (len(x) * len(z) * len(heading))))
        error = grid.poses - mean
        error[:, 2] = wrap_angle(error[:, 2])
        return grid._with(np.exp(-0.5 * np.einsum("ni,ij,nj->n", error, np.linalg.inv(cov), error)))

    @property
    def poses(self) -> Array:
        """Centres (X·Z·H, 3) of all cells, in the order of `p.ravel()`."""
        return np.stack(np.meshgrid(self.x, self.z, self.heading, indexing="ij"), axis=-1).reshape(-1, 3)

    @property
    def mean(self) -> Array:
        """Mean pose (3,), the heading as a direction."""
        heading = np.angle(self.p.sum(axis=(0, 1)) @ np.exp(1j * self.heading))
        return np.array([self.p.sum(axis=(1, 2)) @ self.x, self.p.sum(axis=(0, 2)) @ self.z, heading])

    @property
    def cov(self) -> Array:
        """Covariance (3, 3) about the mean, without the cells' own extent."""
        error = self.poses - self.mean
        error[:, 2] = wrap_angle(error[:, 2])
        return (error * self.p.reshape(-1, 1)).T @ error

    def update(self, log_likelihood: Callable[[Array], Array]) -> "GridFilter":
        """Return p(pose | measurement): log_likelihood maps poses (N, 3) to (N,), up to a constant.

        Cells that could not matter (below 1e-12 of the best) are not evaluated and become 0.
        """
        flat = self.p.ravel()
        likely = flat > 1e-12 * flat.max()
        log_posterior = np.full(len(flat), -np.inf)
        log_posterior[likely] = np.log(flat[likely]) + log_likelihood(self.poses[likely])
        return self._with(np.exp(log_posterior - log_posterior.max()))

    def predict(self, increment: Increment, noise_cov: Array) -> "GridFilter":
        """Return p(next pose) after the motion `increment`.mean + N(0, noise_cov), both in the robot's frame.

        noise_cov: (3, 3) of (right, backward, turn). For every pair of headings the slice is shifted by the motion that
        this turn makes likely and blurred by what noise is left, by Fourier transform: exact also between cells.
        Raises ValueError when the noise of the turn is too narrow for the cells, or mass reaches the border of x, z.
        """
        step = self.heading[1] - self.heading[0]
        turn_sigma = np.sqrt(noise_cov[2, 2])
        if turn_sigma < NARROWEST_SIGMA_CELLS * step:
            raise ValueError(f"turn noise {turn_sigma:.4f} rad is too narrow for cells of {step:.4f} rad")
        reach = int(np.ceil(6 * turn_sigma / step))
        centre = round(increment.mean[2] / step)
        offsets = np.arange(centre - reach, centre + reach + 1)
        residual = offsets * step - increment.mean[2]
        turn_weight = np.exp(-0.5 * (residual / turn_sigma) ** 2)
        turn_weight /= turn_weight.sum()
        # Given the turn, the translation is Gaussian: conditional mean and covariance.
        gain = noise_cov[:2, 2] / noise_cov[2, 2]
        left_cov = noise_cov[:2, :2] - np.outer(gain, noise_cov[2, :2])

        spectrum = np.fft.fft2(self.p, axes=(0, 1))
        moved = np.zeros_like(spectrum)
        for source, heading in enumerate(self.heading):
            to_map = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
            blurred = spectrum[:, :, source] * self._characteristic(np.zeros(2), to_map @ left_cov @ to_map.T)
            for offset, weight, rest in zip(offsets, turn_weight, residual, strict=True):
                shift = to_map @ (increment.mean[:2] + gain * rest)
                target = (source + offset) % len(self.heading)
                moved[:, :, target] += weight * blurred * self._characteristic(shift, np.zeros((2, 2)))
        # The transform leaves ripples of rounding size around zero.
        result = self._with(np.maximum(np.fft.ifft2(moved, axes=(0, 1)).real, 0.0))
        border = 1.0 - result.p[2:-2, 2:-2].sum()
        if border > BORDER_MASS:
            raise ValueError(f"{border:.1e} of the mass reached the border of the grid")
        return result

    def _characteristic(self, mean: Array, cov: Array) -> Array:
        # exp(-i k·mean - ½ kᵀ cov k) at the grid's frequencies: shifts by the mean, blurs by the covariance.
        kx = 2 * np.pi * np.fft.fftfreq(len(self.x), self.x[1] - self.x[0])[:, None]
        kz = 2 * np.pi * np.fft.fftfreq(len(self.z), self.z[1] - self.z[0])[None, :]
        blur = cov[0, 0] * kx**2 + 2 * cov[0, 1] * kx * kz + cov[1, 1] * kz**2
        return np.exp(-1j * (kx * mean[0] + kz * mean[1]) - 0.5 * blur)

    def _with(self, weight: Array) -> "GridFilter":
        return replace(self, p=(weight / weight.sum()).reshape(self.p.shape))
