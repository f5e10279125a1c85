"""The height of the camera above the floor, learnt from where the edges of known landmarks end (docs/filter.md).

Ends that are hidden, a fraction that differs from room to room, are far from where they should be. So the error δ of
the stated height is not Gaussian, and its probability is kept on a grid. Half of the variance of an end is common to
those of an image, what is left of an error of the tilt, and their number does not average it away. A height that was
measured for each image errs in each image in its own way and is taken as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array
from localiser.observation import ENDPOINT_SIGMA_PX

OFFSETS_M: Array = np.linspace(-0.4, 0.4, 161)
STATED_SIGMA_M = 0.03  # of a height that people measure or take from a drawing
UNEVEN_M = 0.01  # how even a floor is between the robot and what it looks at [DIN 18202]
MISSED_SHARES = (0.2, 0.5, 0.8, 0.95)  # how many ends of an image are not their landmark's: hidden, or cut in two
FORGOTTEN = 1e-6  # probability, with each image, that what was learnt is wrong
# In which the height is corrected, so that what depends on it need not be worked out for every image.
STEP_M = float(OFFSETS_M[-1] - OFFSETS_M[0]) / (len(OFFSETS_M) - 1)
LEAST_NOVELTY = 0.2  # between images that are learnt from
COARSE_M: Array = np.linspace(-0.2, 0.2, 17)  # the offsets that are weighed together with poses
COARSE_SIGMA_M = float(COARSE_M[-1]) / (len(COARSE_M) - 1)  # half of their distance, so that none falls between them
UNKNOWN_SIGMA_M = 0.02  # sigma from which on they are
IMAGE_POWER = 0.6  # of the likelihood over particles, here and where wheels are judged: edges of an image err together
_SIGMAS = 3.0  # from which on an offset contradicts what is stated

_STATED: Array = np.exp(-0.5 * (OFFSETS_M / STATED_SIGMA_M) ** 2)
_STATED /= _STATED.sum()
_APART_M: Array = 2.0 * np.linspace(OFFSETS_M[0], OFFSETS_M[-1], 2 * len(OFFSETS_M) - 1)  # of two offsets


@dataclass(frozen=True, slots=True, eq=False)
class Height:
    """How much higher the camera is than stated. probability: (K,) of each of `OFFSETS_M`. novelty: not yet used."""

    probability: Array = field(default_factory=_STATED.copy)
    novelty: float = 0.0

    @property
    def mean_m(self) -> float:
        """The expected offset."""
        return float(self.probability @ OFFSETS_M)

    @property
    def _variance(self) -> float:
        return float(self.probability @ (OFFSETS_M - self.mean_m) ** 2)

    @property
    def sigma_m(self) -> float:
        """How certain the offset is, 1 sigma, on a floor that is as even as floors are."""
        return float(np.sqrt(self._variance + UNEVEN_M**2))

    def warning(self, stated_m: float) -> str:
        """Return what a user should know of the stated height, "" where it may be right."""
        if abs(self.mean_m) <= _SIGMAS * self.sigma_m:
            return ""
        sign = "higher" if self.mean_m > 0 else "lower"
        return (
            f"the camera is {abs(self.mean_m):.2f} m {sign} than the {stated_m:.3f} m that are stated: "
            f"{stated_m + self.mean_m:.3f} m ± {self.sigma_m:.3f} m by where the edges of landmarks end. "
            "That height is used; set it in the camera's file"
        )

    @property
    def is_unknown(self) -> bool:
        """Whether a pose is needed as much for the height as the height for a pose."""
        return self._variance > UNKNOWN_SIGMA_M**2

    def with_poses(self, log_likelihood: Callable[[float], float], novelty: float) -> Height:
        """Return what is known after an image, over all poses that the robot may have.

        log_likelihood: the logarithm of the mean likelihood of the image over particles, by the offset of the height.
        """
        fit = np.array([log_likelihood(offset_m) for offset_m in COARSE_M])
        log_fit = IMAGE_POWER * novelty * np.interp(OFFSETS_M, COARSE_M, fit - fit.max())
        known = ((1.0 - FORGOTTEN) * self.probability + FORGOTTEN * _STATED) * np.exp(log_fit)
        return Height(known / known.sum())

    def after(self, offset: Array, per_height: Array, camera: Camera) -> Height:
        """Return what is known after the ends (P,) of an image, `Association.end_offsets` at the stated height."""
        if not len(offset):
            return replace(self, novelty=0.0)
        sigma = ENDPOINT_SIGMA_PX / camera.focal_px / np.sqrt(2)  # of what is each end's own, and of what is common
        off = (offset[:, None] - per_height[:, None] * OFFSETS_M) / sigma
        _, _, e_low, e_high = camera.upright_bounds
        there = np.exp(-0.5 * off**2) * (e_high - e_low) / (np.sqrt(2 * np.pi) * sigma)
        log_fits = [np.log(missed + (1.0 - missed) * there).sum(axis=0) for missed in MISSED_SHARES]
        log_fit = self.novelty * np.logaddexp.reduce(log_fits)
        common = _APART_M * median(np.abs(per_height).tolist()) / sigma
        fit = np.convolve(np.exp(-0.5 * common**2), np.exp(log_fit - log_fit.max()), "valid")
        known = (1.0 - FORGOTTEN) * self.probability + FORGOTTEN * _STATED
        return Height(known * fit / (known @ fit))

    def corrected(self, edges: Edges, camera: Camera, *, is_tracked: bool) -> Edges:
        """Return the edges as seen from the height that is learnt, with its sigma while that matters.

        is_tracked: whether a place is. Where none is, the sigma is left out: ends must tell places apart, and most
        stated heights are right.
        """
        if is_measured(camera, edges):
            sigma = camera.at(edges.mount).mount.sigma
            return edges if sigma is None or sigma.height_m is None else replace(edges, height_sigma_m=sigma.height_m)
        sigma_m = float(np.sqrt(self._variance))
        if is_tracked and sigma_m > UNEVEN_M:
            edges = replace(edges, height_sigma_m=min(sigma_m, STATED_SIGMA_M))
        if abs(self.mean_m) < self.sigma_m:
            return edges
        return raised(edges, camera, round(self.mean_m / STEP_M) * STEP_M)


def raised(edges: Edges, camera: Camera, offset_m: float) -> Edges:
    """Return the edges as seen from so far above the stated height."""
    stated = camera.at(edges.mount).mount
    height_m = max(stated.height_m + offset_m, STEP_M)  # above the floor
    range_m = edges.foot_range_m * (height_m / stated.height_m)
    return replace(edges, mount=replace(stated, height_m=height_m), foot_range_m=range_m)


def is_measured(camera: Camera, edges: Edges) -> bool:
    """Whether the height was measured for this image: it is not the camera's usual one, or has a sigma of its own."""
    mount = camera.at(edges.mount).mount
    has_sigma = mount.sigma is not None and mount.sigma.height_m is not None
    return has_sigma or mount.height_m != camera.mount.height_m
