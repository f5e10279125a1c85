"""What says how the robot moved between two images: wheels, the camera, or both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Increment
from localiser.increments.estimate import Followed, follow
from localiser.increments.fuse import mixture
from localiser.increments.parameters import IncrementParameters
from localiser.increments.solve import Gaussian

_LEAST_SIGMA = np.array([1e-3, 1e-3, 5e-4])


@dataclass(frozen=True, slots=True, eq=False)
class Odometer:
    """Turns what wheels and two frames say into one increment, by one camera."""

    camera: Camera
    parameters: IncrementParameters

    @property
    def needs_wheels(self) -> bool:
        """Whether an image must wait until wheels have reached its time."""
        return self.parameters.source != "vision"

    def increment(
        self, wheel: Increment, wheel_cov: Array, before: Edges | None, after: Edges, seconds: float
    ) -> Increment:
        """Return the motion over `seconds`, as wheels, edges or both say.

        wheel_cov: (3, 3), of the wheels' motion. before: the edges of the last image, None when there was none.
        """
        if self.parameters.source == "wheel" or seconds <= 0:
            return wheel
        frames = (Edges.none() if before is None else before, after)
        anything = Gaussian(np.zeros(3), self.parameters.motion_cov(seconds))
        slipped = follow(*frames, self.camera, anything)
        if self.parameters.source == "vision":
            return _by_vision(slipped)
        # Wheels that stand still know it exactly, edges never do.
        trusted = Gaussian(wheel.mean, wheel_cov + np.diag(_LEAST_SIGMA**2))
        turned_as_seen = np.array([*wheel.mean[:2], slipped.mean[2]])
        starts = (wheel.mean, turned_as_seen, slipped.mean)
        # Feet err alike for metres on end (skirting boards, the tilt); wheels that do not slip know better how far.
        held = follow(*frames, self.camera, trusted, starts, feet=False)
        share = self.parameters.slip_share
        fused = mixture(
            [Gaussian(held.mean, held.cov), Gaussian(slipped.mean, slipped.cov)],
            np.array([held.log_evidence + np.log1p(-share), slipped.log_evidence + np.log(share)]),
        )
        return Increment(fused.mean, fused.cov, wheel.path_m, wheel.turned_rad, "both")


def _by_vision(seen: Followed) -> Increment:
    # How far it may well have come: a robot of which nothing is known has not stood still.
    path_m = np.sqrt(np.square(seen.mean[:2]).sum() + np.trace(seen.cov[:2, :2]))
    turned_rad = np.sqrt(seen.mean[2] ** 2 + seen.cov[2, 2])
    return Increment(seen.mean, seen.cov, float(path_m), float(turned_rad), "vision")
