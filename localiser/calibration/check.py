"""Whether the edges of a run agree with the tilt and roll that were stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from localiser.calibration.lean import mount_with_leans
from localiser.calibration.lines import Lines, lines_of
from localiser.calibration.log_mount import spread
from localiser.calibration.plumb import fitted, voted
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array

_MOST_IMAGES = 500
_SURE = 13.8  # squared Mahalanobis distance in two dimensions that chance exceeds in 0.1 % of the cases
_BELIEVED = 1.0  # within one sigma of what is believed the filter reckons with the error


@dataclass(frozen=True, slots=True, eq=False)
class MountCheck:
    """What the edges of a run say about tilt and roll: stated (2,), found (2,), cov (2, 2), rad.

    disagrees: that stated and found differ is sure, and it is more than the sigma of the stated one.
    """

    stated: Array
    found: Array
    cov: Array
    disagrees: bool

    @property
    def sigma(self) -> Array:
        """The sigma (2,) of what was found."""
        return np.sqrt(np.diag(self.cov))

    def warning(self, log: Path) -> str | None:
        """Return what to tell people of the log at a path, None where found and stated agree."""
        if not self.disagrees:
            return None
        stated, found, sigma = (np.rad2deg(values) for values in (self.stated, self.found, self.sigma))
        return (
            f"The edges say that the camera's tilt is {found[0]:.2f}° ± {sigma[0]:.2f}° and its roll {found[1]:.2f}° ± "
            f"{sigma[1]:.2f}°; stated are {stated[0]:.2f}° and {stated[1]:.2f}°. See `localiser camera tilt {log}`."
        )


def check_mount(frames: Sequence[Edges], poses: Array, camera: Camera, stated_sigma_rad: Array) -> MountCheck:
    """Return what the edges of F images, taken at poses (F, 3) of the odometry, say about the mount of `camera`.

    stated_sigma_rad: (2,) how certain the stated tilt and roll are taken to be.
    """
    stated = np.array([camera.mount.tilt_rad, camera.mount.roll_rad])
    used = spread(len(frames), _MOST_IMAGES) if frames else []
    lines = Lines.together([lines_of(frames[image], camera, index) for index, image in enumerate(used)])
    plumb = fitted(lines, stated, voted(lines, stated))
    found = mount_with_leans(lines, plumb, poses[used], camera, stated)
    off = found.mount - stated
    sure = off @ np.linalg.solve(found.cov, off) > _SURE
    beyond = off @ np.linalg.solve(found.cov + np.diag(stated_sigma_rad**2), off) > _BELIEVED
    return MountCheck(stated, found.mount, found.cov, bool(sure and beyond))
