"""A camera that moves on the robot: a head that pans and tilts, a lift, a robot that balances."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from localiser.camera import Mount, MountSigma
from localiser.simulate.robot import MountMotionSpec, Sway


def mount_at(mount: Mount, motion: MountMotionSpec | None, t_ns: int) -> Mount:
    """Return the true mount at a time: the usual one, plus what each part sways by."""
    if motion is None:
        return mount
    return replace(
        mount,
        tilt_rad=mount.tilt_rad + math.radians(_swayed(motion.tilt_deg, t_ns)),
        roll_rad=mount.roll_rad + math.radians(_swayed(motion.roll_deg, t_ns)),
        yaw_rad=mount.yaw_rad + math.radians(_swayed(motion.yaw_deg, t_ns)),
        height_m=mount.height_m + _swayed(motion.height_m, t_ns),
    )


def stated_mount(true: Mount, motion: MountMotionSpec, rng: np.random.Generator) -> Mount:
    """Return the mount as the robot states it: tilt and roll err by `stated_sigma_deg`, anew in each image."""
    sigma_rad = math.radians(motion.stated_sigma_deg)
    if sigma_rad == 0.0:
        return true
    tilt, roll = sigma_rad * rng.standard_normal(2)
    sigma = MountSigma(tilt_rad=sigma_rad, roll_rad=sigma_rad)
    return replace(true, tilt_rad=true.tilt_rad + float(tilt), roll_rad=true.roll_rad + float(roll), sigma=sigma)


def _swayed(sway: Sway | None, t_ns: int) -> float:
    if sway is None:
        return 0.0
    return sway.amplitude * math.sin(2.0 * math.pi * sway.hz * t_ns / 1e9 + math.radians(sway.phase_deg))
