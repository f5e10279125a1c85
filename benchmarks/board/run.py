"""One drive through the localiser: what it said at each image beside what was true, and the figures of it.

Only the public `Localiser` is driven, with its default settings and those that a log states of its robot.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from time import thread_time
from typing import Any, NamedTuple

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
BINS = 10  # of p_correct
LEAST = 1e-6  # probability that the log score takes for 0
NEVER = math.inf

Values = dict[str, float]


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
    carried: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """What the filter said of T images.

    seconds: (T,) since the first. error: (T, 3) of the estimate in x, z, heading; nan where the map is not that of the
    building, so that nothing is right. p_correct: (T,). warned: (T,) whether it said that the map does not fit.
    took_over: (T,) whether the pose jumped to another place. nees: (T,). ms: (T,) processor time since the image
    before.
    """

    seconds: Array
    error: Array
    p_correct: Array
    warned: NDArray[np.bool_]
    took_over: NDArray[np.bool_]
    nees: Array
    ms: Array

    @property
    def error_m(self) -> Array:
        """Position error (T,), infinite where no estimate can be right."""
        return np.nan_to_num(np.hypot(self.error[:, 0], self.error[:, 1]), nan=np.inf)

    @property
    def right(self) -> NDArray[np.bool_]:
        """Whether (T,) the estimate is within 0.5 m and 10°."""
        return (self.error_m <= CORRECT_M) & (np.abs(self.error[:, 2]) <= CORRECT_RAD)

    @property
    def sure(self) -> NDArray[np.bool_]:
        """Whether (T,) p_correct is above 0.9."""
        return self.p_correct > SURE


def run(
    drive: Drive,
    seed: int,
    *,
    start: Array | str | None = "truth",
    observation: str = "line",
    landmark_map: LandmarkMap | None = None,
    same_building: bool = True,
    settings: tuple[str, ...] = (),
) -> Record:
    """Return what the filter says along a drive.

    start: a pose (3,) that is stated with `START_SIGMA`; "truth" for the true one with an error of that size, drawn as
    `localiser replay --start truth` draws it; None for anywhere. landmark_map: in place of the drive's own.
    same_building: whether an estimate on that map can be right.
    """
    config = read_config(drive.config, [f"observation.kind={observation}", *settings], drive.settings)
    robot = Localiser(landmark_map or drive.landmark_map, drive.camera, config, seed)
    robot.warm_up(images=False)
    if isinstance(start, str):
        start = drive.truth[0] + START_SIGMA * robot.rng.standard_normal(3)
    if start is not None:
        robot.start(np.append(start[:2], wrap_angle(start[2])), np.diag(START_SIGMA**2), int(drive.t_ns[0]))
    truth = drive.truth if same_building else np.full(drive.truth.shape, np.nan)
    return record_of(located(robot, drive), truth, robot.landmark_map)


def record_of(found: Iterable[tuple[LocatedFrame, float]], truth: Array, landmark_map: LandmarkMap) -> Record:
    """Return what was said in T images, and how wrong it was. truth: (T, 3), nan where nothing is right.

    found: what `located` yields; their particles are not kept. landmark_map: in whose frame truth is, that of all maps
    where there are several.
    """
    rows = []
    for frame, ms in found:
        one = frame.located
        pose = one.estimate.pose + landmark_map.origin(frame.map_name)
        rows.append((one.t_ns, pose, one.estimate.pose_cov, one.p_correct, bool(one.warning), one.took_over, ms))
    t_ns, poses, covs, p_correct, warned, took_over, ms_of = (np.array(column) for column in zip(*rows, strict=True))
    error = poses - truth
    error[:, 2] = wrap_angle(error[:, 2])
    return Record(
        seconds=(t_ns - t_ns[0]) / 1e9,
        error=error,
        p_correct=p_correct,
        warned=warned,
        took_over=took_over,
        nees=nees(error, covs),
        ms=ms_of,
    )


def located(robot: Localiser, drive: Drive) -> Iterator[tuple[LocatedFrame, float]]:
    """Yield every located image, and the processor time (ms) of all work since the one before."""
    wheels = ((int(t), 0, pose) for t, pose in zip(drive.odometry.t_ns, drive.odometry.poses, strict=True))
    images = ((int(t), 1, edges) for t, edges in zip(drive.t_ns, drive.edges, strict=True))
    begin = thread_time()
    for event in itertools.chain(heapq.merge(wheels, images, key=lambda event: event[:2]), [None]):
        if event is None:
            found = robot.finish()
        else:
            found = robot.edges(event[0], event[2]) if event[1] else robot.odometry(event[0], event[2])
        if found:
            ms = 1e3 * (thread_time() - begin) / len(found)
            yield from ((frame, ms) for frame in found)
            begin = thread_time()


# -- figures -----------------------------------------------------------------------------------------------------------


class Figure(NamedTuple):
    """What a figure means, and how it is compared and printed.

    floor: a change that is smaller counts as none. is_rate: printed in per cent, compared in points. is_judged: whether
    a change of it is good or bad by itself. is_shown: whether tables have it, or comparisons alone.
    """

    title: str
    meaning: str
    digits: int = 2
    floor: float = 0.01
    is_rate: bool = False
    more_is_better: bool = False
    is_judged: bool = True
    is_shown: bool = True


_SINCE = "of every image since found"
FIGURES = {
    "rmse_m": Figure("RMSE m", f"root of the mean square of the position error, {_SINCE}", 4, 0.0005),
    "median_m": Figure("median m", f"median of the position error, {_SINCE}", 4, 0.0005, is_shown=False),
    "heading_deg": Figure("heading °", f"root of the mean square of the heading error, {_SINCE}"),
    "nees": Figure("NEES", f"mean of the normalised estimation error squared, {_SINCE}; 3 if honest"),
    "found": Figure("found", "images until the first of five in succession that are right: within 0.5 m and 10°", 0, 1),
    "sure": Figure("sure %", "share of the images with p_correct above 0.9", is_rate=True, more_is_better=True),
    "sure_wrong": Figure(
        "sure, wrong %", "share of the images with p_correct above 0.9 that are not right", is_rate=True
    ),
    "ece": Figure("ECE %", "expected calibration error of p_correct, ten bins", is_rate=True),
    "log_score": Figure(
        "log score", "mean logarithm of the probability that was given to what is true", 3, more_is_better=True
    ),
    "warned_s": Figure("warned s", "seconds until it is said that a wrong map does not fit", 1, 0.2),
    "warned": Figure("warned %", "share of the images in which the right map is said not to fit", is_rate=True),
    "ms": Figure("ms", "processor time of an image, mean; edges not counted", 1, is_judged=False),
    "recall": Figure("recall %", "share of the hand-labelled edges that are found", is_rate=True, more_is_better=True),
    "precision": Figure("precision %", "share of the edges found that are labelled", is_rate=True, more_is_better=True),
    "bearing_deg": Figure("bearing °", "median error of the bearing of an edge", 3),
    "tilt_deg": Figure("tilt °", "median error of the tilt that the edges of a photograph tell"),
    "roll_deg": Figure("roll °", "median error of the roll that they tell"),
    "within_1_deg": Figure(
        "within 1° %", "share of the photographs whose tilt and roll are right to 1°", is_rate=True, more_is_better=True
    ),
}


def figures(record: Record, *, first: int = 0, stated: bool = False) -> Values:
    """Return the figures of a run.

    first: image from which on it is judged: where the robot was set down. stated: whether a true start was stated, so
    that all images count as found.
    """
    error_m, turn, p_correct = record.error_m[first:], np.abs(record.error[first:, 2]), record.p_correct[first:]
    right, sure = record.right[first:], record.sure[first:]
    in_succession = np.convolve(right, np.ones(SETTLED), "valid") == SETTLED
    found = float(in_succession.argmax()) if in_succession.any() else NEVER
    since = slice(0 if stated else int(min(found, len(right))), None)
    known = len(error_m[since]) > 0 and np.isfinite(error_m).all()
    warned, seconds = record.warned[first:], record.seconds[first:] - record.seconds[first]
    is_wrong = np.isnan(record.error).any()  # the map is
    said = np.clip(np.where(right, p_correct, 1.0 - p_correct), LEAST, 1.0)
    bins = np.minimum((p_correct * BINS).astype(int), BINS - 1)
    gaps = np.bincount(bins, p_correct - right, minlength=BINS)
    return {
        "rmse_m": float(np.sqrt(np.mean(error_m[since] ** 2))) if known else NEVER,
        "median_m": float(np.median(error_m[since])) if known else NEVER,
        "heading_deg": float(np.rad2deg(np.sqrt(np.mean(turn[since] ** 2)))) if known else NEVER,
        "nees": float(np.nanmean(record.nees[first:][since])) if known else NEVER,
        "found": found,
        "sure": float(sure.mean()),
        "sure_wrong": float((sure & ~right).mean()),
        "ece": float(np.abs(gaps).sum() / len(right)),
        "log_score": float(np.log(said).mean()),
        **({"warned_s": float(seconds[warned.argmax()]) if warned.any() else NEVER} if is_wrong else {}),
        **({} if is_wrong else {"warned": float(warned.mean())}),
        "ms": float(record.ms[1:].mean()),
    }
