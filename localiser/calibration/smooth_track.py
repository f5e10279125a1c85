"""Smooth the path of a finished run: every pose by what came after it too (Rauch, Tung, Striebel 1965).

    gain = P_k Fᵀ (F P_k Fᵀ + Q)⁻¹
    x_k ← x_k + gain (x_{k+1} - f(x_k)),    P_k ← P_k + gain (P_{k+1} - F P_k Fᵀ - Q) gainᵀ

with f the motion by odometry between two images, F its derivative, Q its noise, and x, P poses and covariances of the
filter. The result depends less on the odometry than the filter's path, because errors that came up late are corrected.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from localiser.geometry import Array, Increment, compose, wrap_angle
from localiser.motion import MotionParameters, linearised


def smooth_path(
    poses: Array, covs: Array, increments: Sequence[Increment], motion: MotionParameters
) -> tuple[Array, Array]:
    """Return poses (T, 3) and covariances (T, 3, 3) of a run with what came later.

    increments: (T - 1) motions by odometry, from each image to the next.
    """
    poses, covs = poses.copy(), covs.copy()
    for k in range(len(poses) - 2, -1, -1):
        by_pose, noise = linearised(poses[k], increments[k], motion)
        expected_cov = by_pose @ covs[k] @ by_pose.T + noise + 1e-12 * np.eye(3)
        gain = covs[k] @ by_pose.T @ np.linalg.inv(expected_cov)
        off = poses[k + 1] - compose(poses[k], increments[k].mean)
        off[2] = wrap_angle(off[2])
        poses[k] += gain @ off
        covs[k] += gain @ (covs[k + 1] - expected_cov) @ gain.T
    return poses, covs
