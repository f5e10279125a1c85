"""Whether the edges that were found agree with the tilt and roll that the camera file states."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from localiser.commands.edges.run import EdgeRun

_CLEAR = 9.2  # squared Mahalanobis distance in two dimensions that chance exceeds in 1 % of the cases


def mount_warnings(run: EdgeRun) -> Iterator[str]:
    """Yield a text for each detector whose edges contradict the stated mount clearly; see `check_mount`.

    Nothing says how far apart images were taken, so all together are as certain as one of them. One image may well
    contradict the truth by a sigma of what is stated, so more is asked than of a whole run.
    """
    from localiser.calibration import check_mount

    believed_rad = run.config.edges.mount_sigma_rad
    for name, frames in run.kept.items():
        check = check_mount(frames, np.zeros((len(frames), 3)), run.camera, believed_rad)
        off, cov = check.found - check.stated, check.cov + np.diag(believed_rad**2)
        if check.disagrees and off @ np.linalg.solve(cov, off) > _CLEAR:
            stated, found, sigma = (np.rad2deg(values) for values in (check.stated, check.found, check.sigma))
            yield (
                f"The lines that {name} found say that the camera's tilt is {found[0]:z.1f}° ± {sigma[0]:.1f}° and "
                f"its roll {found[1]:z.1f}° ± {sigma[1]:.1f}°; stated are {stated[0]:.2f}° and {stated[1]:.2f}°. Until "
                "the camera file is right, edges are missed and bearings are off. See `localiser camera tilt`."
            )
