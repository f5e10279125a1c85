"""Whether a path that was found agrees with the wheels: their constant errors with the priors, and their noise.

Wrong loops bend a path until the bearings fit. What they leave behind is a path that the wheels should have measured
otherwise: by a constant error that is not credible, or by more than their noise over some stretch of the way.
"""

from __future__ import annotations

import numpy as np

from localiser.geometry import Array
from localiser.mapping.factors import CONSTANTS, Prior, Wheels, wheel_residuals
from localiser.mapping.sightings import Index

_CONSTANTS_CHI2 = 16.3  # 99.7 % of a Gaussian of four dimensions
_STRETCHES = (1, 10, 30, 100)  # steps between images, over which the noise is compared
_CHANCE = 0.003  # that the noise of right wheels alone contradicts a path


def contradicting_steps(wheels: Wheels, poses: Array, constants: Array) -> Index:
    """Return the steps (K,), each from image k to k + 1, in which a path contradicts the wheels."""
    chi2 = (wheel_residuals(wheels, poses, constants) ** 2).sum(axis=1)
    return np.flatnonzero(chi2 > _largest_chi2(len(chi2)))


def contradiction(wheels: Wheels, prior: Prior, poses: Array, constants: Array) -> str | None:
    """Return in words how a path contradicts the wheels; None where it does not.

    poses: (T, 3). constants: (4,) of wheels and mount, as in `factors.CONSTANTS`. prior: what is stated of them.
    """
    sigmas = (constants - prior.mean) / prior.sigma
    if sigmas @ sigmas > _CONSTANTS_CHI2:
        worst = int(np.abs(sigmas).argmax())
        return f"the wheels' constant errors would be {abs(sigmas[worst]):.1f} sigmas off ({CONSTANTS[worst]})"
    residual = wheel_residuals(wheels, poses, constants)
    gate = _largest_chi2(len(residual))
    for steps in _STRETCHES:
        count = len(residual) // steps
        sums = residual[: count * steps].reshape(count, steps, 3).sum(axis=1)
        chi2 = (sums**2).sum(axis=1) / steps
        if count and chi2.max() > gate:
            first = int(chi2.argmax()) * steps
            return f"the wheels would be {np.sqrt(chi2.max()):.1f} sigmas off from image {first} to {first + steps}"
    return None


def _largest_chi2(count: int) -> float:
    """Return what the largest χ² of `count` Gaussians of three dimensions exceeds with the probability `_CHANCE`.

    The longer the drive, the farther off the noise of its worst step.
    """
    from scipy.special import chdtri

    return float(chdtri(3, _CHANCE / max(count, 1)))
