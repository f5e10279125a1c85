"""The parts of a recorded log that building a map needs: poses, motion of the wheels, edges of each image."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from localiser import motion
from localiser.camera import Camera, Mount
from localiser.errors import InputError
from localiser.filter import Sighting, Start
from localiser.geometry import Array, Increment, Trajectory, Twist, between, bridged, compose
from localiser.mapping.factors import Wheels
from localiser.motion import MotionParameters

TRUTH, ODOMETRY, SLAM = "truth", "odometry", "slam"
KNOWN_TURN_RAD = 1e-3
"""How far poses that are said to be true may be off between two images: synchronisation, interpolation."""
_LEAST_SIGMA = np.array([1e-3, 1e-3, 5e-4])
"""Error of the wheels between two images even at a stand: right, backward (m), turn (rad)."""


class RecordedImage(Protocol):
    """An image of a log, read when it is asked for; encoded: the file as it is."""

    @property
    def t_ns(self) -> int: ...  # noqa: D102
    @property
    def load(self) -> Callable[[], NDArray[np.uint8]]: ...  # noqa: D102
    @property
    def encoded(self) -> Callable[[], bytes]: ...  # noqa: D102
    @property
    def mount(self) -> Mount | None: ...  # noqa: D102


class RecordedLog(Protocol):
    """A log as `storage.Log` has it: frames are images, or edges that were measured already."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def path(self) -> Path: ...  # noqa: D102
    @property
    def camera(self) -> Camera: ...  # noqa: D102
    @property
    def odometry(self) -> Trajectory: ...  # noqa: D102
    @property
    def groundtruth(self) -> Trajectory | None: ...  # noqa: D102
    @property
    def start(self) -> Start | None: ...  # noqa: D102
    @property
    def frames(self) -> Sequence[RecordedImage | Sighting]: ...  # noqa: D102
    def twist_at(self, t_ns: int) -> Twist | None: ...  # noqa: D102


def known_poses(log: RecordedLog, poses: str) -> Trajectory:
    """Return the robot's poses in the map frame by the log's `truth` or `odometry`. Raises InputError.

    Odometry is moved so that it begins at the log's stated start, where it has one.
    """
    if poses == TRUTH:
        if log.groundtruth is None:
            raise InputError("the log has no true poses; expected another --poses", path=log.path, field="groundtruth")
        return log.groundtruth
    if poses != ODOMETRY:
        raise InputError(
            f"expected {TRUTH}, {ODOMETRY}, {SLAM} or the path of a trajectory, found {poses!r}", field="--poses"
        )
    if not len(log.odometry):
        raise InputError(
            f"the log has no odometry, which {ODOMETRY} and {SLAM} need; expected --poses {TRUTH} or a trajectory",
            path=log.path,
            field="--poses",
        )
    wheels, _ = bridged(log.odometry)
    if log.start is None:
        return wheels
    return Trajectory(wheels.t_ns, compose(log.start.mean, between(wheels.at(log.start.t_ns), wheels.poses)))


def wheels_of(odometry: Trajectory, t_ns: NDArray[np.int64], parameters: MotionParameters) -> Wheels:
    """Return what the wheels say of the motion between the times (T,), with its noise by the motion model.

    Where the odometry jumps it is bridged.
    """
    odometry, _ = bridged(odometry)
    poses = odometry.sampled(t_ns).poses
    moves = between(poses[:-1], poses[1:])
    steps = between(odometry.poses[:-1], odometry.poses[1:])
    path_m = _between_times(odometry, np.hypot(steps[:, 0], steps[:, 1]), t_ns)
    turned = _between_times(odometry, np.abs(steps[:, 2]), t_ns)
    noise_only = replace(parameters, bias=motion.EXACT)
    whole = (
        Increment(move, np.zeros((3, 3)), float(path), float(turn))
        for move, path, turn in zip(moves, path_m, turned, strict=True)
    )
    cov = np.array([motion.wheel_cov(increment, noise_only) for increment in whole]) + np.diag(_LEAST_SIGMA**2)
    return Wheels(moves, np.where(moves[:, 1] > 0, -path_m, path_m), cov)


def _between_times(odometry: Trajectory, step: Array, t_ns: NDArray[np.int64]) -> Array:
    """Return how much of `step` (T' - 1,), made between poses of the odometry, lies between the times (T,)."""
    whole = np.concatenate([[0.0], np.cumsum(step)])
    seconds = (odometry.t_ns - odometry.t_ns[0]) / 1e9
    return np.asarray(np.diff(np.interp((t_ns - odometry.t_ns[0]) / 1e9, seconds, whole)))


def turn_sigmas(trajectory: Trajectory, parameters: MotionParameters) -> Array:
    """Return by how much (T,) rad the turn since the frame before may be off, for poses from odometry."""
    moves = between(trajectory.poses[:-1], trajectory.poses[1:])
    turns = [motion.noise_variances(Increment.from_mean(move), parameters)[1] for move in moves]
    return np.hypot(KNOWN_TURN_RAD, np.sqrt([0.0, *turns]))
