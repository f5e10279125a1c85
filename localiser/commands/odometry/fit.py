"""Take the drives of logs, by their truth or by the filter, and fit the odometry to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localiser.calibration import ALPHAS, ClockOffset, Drive, OdometryFit, fit_odometry, on_one_clock, smoothed
from localiser.config import Config
from localiser.documents import dump
from localiser.errors import InputError
from localiser.filter import SURE
from localiser.geometry import Trajectory
from localiser.motion import MotionParameters
from localiser.replay import prepare
from localiser.storage import Log, require_odometry

TRUTH, FILTER = "truth", "filter"
_BIAS = ("distance_sigma", "turn_sigma", "veer_sigma_deg_per_m")


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """A drive on the clock of its wheels. by: what its path is from. clock: how much later that was stamped."""

    drive: Drive
    by: str
    clock: ClockOffset


def drive_of(log: Log, config: Config, *, by_filter: bool = False, map_file: Path | None = None) -> tuple[Drive, str]:
    """Return the drive of a log, and whether its path is from the truth or the filter. Raises InputError."""
    require_odometry(log, "fitting it")
    if log.groundtruth is not None and not by_filter:
        return Drive(log.name, log.odometry, log.groundtruth), TRUTH
    run = prepare(log, config, map_file=map_file)
    run.run()
    located = [frame.located for frame in run.frames]
    sure = _longest(np.array([result.p_correct > SURE for result in located]))
    if len(sure) < 2:
        raise InputError("the robot was not found on the map, so its path is not known", path=log.path)
    poses = np.array([located[i].estimate.pose for i in sure])
    covs = np.array([located[i].estimate.pose_cov for i in sure])
    path, cov = smoothed(poses, covs, [located[i].increment for i in sure[1:]], config.motion)
    times = np.array([located[i].t_ns for i in sure], dtype=np.int64)
    return Drive(log.name, log.odometry, Trajectory(times, path), cov), FILTER


def checked_drive(found: tuple[Drive, str]) -> Checked:
    """Return a drive with its path on the clock of the wheels, where that is of a truth: the filter's is by both."""
    drive, by = found
    if by == FILTER:
        return Checked(drive, by, ClockOffset(0.0, np.inf, 0.0, 0))
    drive, clock = on_one_clock(drive)
    return Checked(drive, by, clock)


def fitted(drives: Sequence[Checked], before: MotionParameters) -> OdometryFit:
    """Return noise and constant errors. Raises InputError when the drives are too short."""
    found = fit_odometry([checked.drive for checked in drives], before)
    if found is None:
        names = ", ".join(checked.drive.name for checked in drives)
        raise InputError(f"expected ten metres or ten radians of driving at least, found less in {names}", field="LOG")
    return found


def to_yaml(drives: Sequence[Checked], found: OdometryFit) -> str:
    """Return the configuration file: what was found, and nothing else."""
    names = ", ".join(f"{checked.drive.name} ({checked.by})" for checked in drives)
    bias = {name: float(f"{getattr(found.motion.bias, name):.4g}") for name in _BIAS}
    values = {name: float(f"{getattr(found.motion, name):.4g}") for name in ALPHAS}
    return f"# Odometry, fitted to: {names}\n{dump({'motion': {**values, 'bias': bias}})}"


def _longest(flags: NDArray[np.bool_]) -> list[int]:
    """Return the indices of the longest run of true flags (T,)."""
    best: list[int] = []
    run: list[int] = []
    for index, flag in enumerate(flags):
        run = [*run, index] if flag else []
        best = run if len(run) > len(best) else best
    return best
