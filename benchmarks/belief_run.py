"""One drive through the localiser, and what it said at each image beside what was true.

Only the public `Localiser` is driven, with its default settings and those that a log states of its robot.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from time import thread_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localiser import Edges, Localiser, LocatedFrame, Trajectory, read_config, wrap_angle
from localiser.evaluate import nees
from localiser.geometry import Array
from localiser.landmarks import LandmarkMap

CORRECT_M, CORRECT_RAD = 0.5, np.deg2rad(10.0)  # what `Located.p_correct` speaks of
SURE = 0.9
SETTLED = 5  # images in succession
START_SIGMA = np.array([0.1, 0.1, np.deg2rad(3.0)])


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What a robot measured, and where it was.

    t_ns: (T,) of the images. edges: T. truth: poses (T, 3). settings: what is known of the robot, by names of the
    configuration; config: a file of it. carried: image from which on the robot is elsewhere without odometry knowing.
    """

    name: str
    landmark_map: LandmarkMap
    camera: Any
    odometry: Trajectory
    t_ns: NDArray[np.int64]
    edges: list[Edges]
    truth: Array
    settings: Mapping[str, Any] = field(default_factory=dict)
    config: Path | None = None
    carried: int | None = None


@dataclass(frozen=True, eq=False)
class Record:
    """What the filter said of T images.

    seconds: (T,) since the first. error: (T, 3) of the estimate in x, z, heading, nan where the map is not that of the
    building. p_correct: (T,). warned: (T,) whether it said that the map does not fit. nees: (T,). expects, shows: (T,)
    landmarks that the estimate should see, edges that there are. ms: (T,) time of this thread for all work since the
    image before.
    """

    seconds: Array
    error: Array
    p_correct: Array
    warned: NDArray[np.bool_]
    nees: Array
    expects: NDArray[np.int64]
    shows: NDArray[np.int64]
    ms: Array

    @cached_property
    def error_m(self) -> Array:
        """Position error (T,), infinite where no estimate can be right."""
        return np.nan_to_num(np.hypot(self.error[:, 0], self.error[:, 1]), nan=np.inf)

    @cached_property
    def right(self) -> NDArray[np.bool_]:
        """Whether (T,) the estimate is within 0.5 m and 10°."""
        return self.within(CORRECT_M)

    @cached_property
    def sure(self) -> NDArray[np.bool_]:
        """Whether (T,) p_correct is above 0.9."""
        return self.p_correct > SURE

    def within(self, distance_m: float) -> NDArray[np.bool_]:
        """Return which (T,) estimates are within a distance and 10°."""
        return np.asarray((self.error_m <= distance_m) & (np.abs(np.nan_to_num(self.error[:, 2])) <= CORRECT_RAD))


def run(
    drive: Drive,
    observation: str,
    seed: int,
    *,
    start: Array | str | None = "truth",
    landmark_map: LandmarkMap | None = None,
    same_building: bool = True,
) -> Record:
    """Return what the filter says along a drive.

    start: a pose (3,) that is stated with `START_SIGMA`; "truth" for the true one with an error of that size, drawn as
    `localiser replay --start truth` draws it; None for anywhere. landmark_map: in place of the drive's own.
    same_building: whether an estimate on that map can be right.
    """
    config = read_config(drive.config, [f"observation.kind={observation}"], drive.settings)
    robot = Localiser(landmark_map or drive.landmark_map, drive.camera, config, seed)
    robot.warm_up(images=False)
    if isinstance(start, str):
        start = drive.truth[0] + START_SIGMA * robot.rng.standard_normal(3)
    if start is not None:
        robot.start(np.append(start[:2], wrap_angle(start[2])), np.diag(START_SIGMA**2), int(drive.t_ns[0]))
    return record_of(*located(robot, drive), drive.truth if same_building else np.full(drive.truth.shape, np.nan))


def record_of(frames: list[LocatedFrame], ms: list[float], truth: Array) -> Record:
    """Return what was said in T images, and how wrong it was. truth: (T, 3), nan where nothing is right."""
    located = [frame.located for frame in frames]
    error = np.array([one.estimate.pose for one in located]) - truth
    error[:, 2] = wrap_angle(error[:, 2])
    t_ns = np.array([one.t_ns for one in located])
    return Record(
        seconds=(t_ns - t_ns[0]) / 1e9,
        error=error,
        p_correct=np.array([one.p_correct for one in located]),
        warned=np.array([bool(getattr(one, "warning", "")) for one in located]),
        nees=nees(error, np.array([one.estimate.pose_cov for one in located])),
        expects=np.array([int(frame.matches.visible.sum()) for frame in frames]),
        shows=np.array([len(one.edges) for one in located]),
        ms=np.array(ms),
    )


def located(robot: Localiser, drive: Drive) -> tuple[list[LocatedFrame], list[float]]:
    """Return every located image, and the time (ms) of all work since the one before."""
    wheels = ((int(t), 0, pose) for t, pose in zip(drive.odometry.t_ns, drive.odometry.poses, strict=True))
    images = ((int(t), 1, edges) for t, edges in zip(drive.t_ns, drive.edges, strict=True))
    frames: list[LocatedFrame] = []
    ms: list[float] = []
    begin = thread_time()
    for t_ns, is_image, measured in heapq.merge(wheels, images, key=lambda event: event[:2]):
        found = robot.edges(t_ns, measured) if is_image else robot.odometry(t_ns, measured)
        if found:
            frames += found
            end = thread_time()
            ms += [1e3 * (end - begin) / len(found)] * len(found)
            begin = end
    last = robot.finish()
    return frames + last, ms + [1e3 * (thread_time() - begin) / max(len(last), 1)] * len(last)


# -- when something was so ---------------------------------------------------------------------------------------------


def settled_at(right: NDArray[np.bool_], first: int = 0) -> int:
    """Return where, counted from `first`, the first five right images in succession begin, -1 for never."""
    run_of = np.convolve(right[first:], np.ones(SETTLED), "valid") == SETTLED
    return int(run_of.argmax()) if run_of.any() else -1


def first_of(hits: NDArray[np.bool_]) -> int:
    """Return the first index that is true, -1 for none."""
    return int(hits.argmax()) if hits.any() else -1
