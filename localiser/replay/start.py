"""Where a replay starts."""

from __future__ import annotations

import numpy as np

from localiser.errors import InputError
from localiser.filter import Start
from localiser.geometry import wrap_angle
from localiser.storage import Log

START_SIGMA = np.array([0.1, 0.1, np.deg2rad(3.0)])
"""How far a start that is given on the command line may be off: x, z (m), heading (rad), one sigma."""

TRUTH, GLOBAL = "truth", "global"


def start_of(log: Log, option: str | None, rng: np.random.Generator) -> Start | None:
    """Return the start of a replay at its first image: as the option says, else as the log states; None for anywhere.

    option: `x,z,heading_deg`, `global` for anywhere on the map, or `truth` for the true pose plus a draw from
    N(0, `START_SIGMA`²). Raises InputError.
    """
    if option is None or option == GLOBAL:
        return log.start if option is None else None
    first_ns = log.frames[0].t_ns
    cov = np.diag(START_SIGMA**2)
    if option == TRUTH:
        return Start(first_ns, _near_truth(log, first_ns, rng), cov)
    return Start(first_ns, given_pose(option), cov)


def _near_truth(log: Log, first_ns: int, rng: np.random.Generator) -> np.ndarray:
    if log.groundtruth is None or not log.groundtruth.covers(first_ns):
        raise InputError(
            "--start truth needs the true pose at the first image, which the log does not have; "
            "say where the robot starts with --start x,z,heading_deg, or have it looked for with --start global",
            path=log.path,
            field="start",
        )
    pose = log.groundtruth.at(first_ns) + START_SIGMA * rng.standard_normal(3)
    pose[2] = wrap_angle(pose[2])
    return np.asarray(pose)


def given_pose(option: str) -> np.ndarray:
    """Return the pose (3,) of `x,z,heading_deg`. Raises InputError."""
    problem = f"expected x,z,heading_deg (metres and degrees, such as 1.5,-2,90), global or truth, found {option!r}"
    try:
        x, z, heading_deg = (float(part) for part in option.split(","))
    except ValueError:
        raise InputError(problem, field="--start") from None
    pose = np.array([x, z, np.deg2rad(heading_deg)])
    if not np.isfinite(pose).all():
        raise InputError(problem, field="--start")
    pose[2] = wrap_angle(pose[2])
    return pose
