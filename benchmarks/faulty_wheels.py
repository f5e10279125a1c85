"""Wheels that are wrong for some seconds: how far off the robot is, how sure, how soon it is right again, and if told.

python benchmarks/faulty_wheels.py                        the logs in LOCALISER_DATA, three places each
python benchmarks/faulty_wheels.py --logs bookstore --faults double half --begin 25 40 --seeds 0 1 2

Each drive begins at its true start 10 s before the fault and ends 16 s after its begin. Told: images of the fault, and
later ones, in which the filter went on without the wheels.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from belief_drives import STEP_NS, drive_of, is_there
from belief_run import CORRECT_M, CORRECT_RAD, START_SIGMA, SURE, Drive, located
from rich.console import Console
from rich.table import Table

from localiser import Localiser, Trajectory, compose, read_config, wrap_angle
from localiser.geometry import Array, between

BEFORE_S, AFTER_S = 10.0, 16.0
BEGIN_S = {"corridor": (12, 20, 28), "house": (20, 33, 46, 60), "bookstore": (12, 25, 40, 55), "office": (12, 25, 38)}
SLIP_RAD_S, SPIN_M_S = np.radians(20.0), 0.4
SECONDS = {"silent": 5.0}  # other faults: 3
FAULTS = ("stand still", "double", "silent", "half", "slip", "spin")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one drive. back: image after the fault from which on all are right."""

    rmse_m: float
    worst_m: float
    sure_and_wrong: float
    back: int
    told: tuple[int, int]


def faulty(drive: Drive, fault: str, begin_ns: int) -> Drive:
    """Return a drive whose wheels err from a time on: a fault of `FAULTS`."""
    wheels, end_ns = drive.odometry, begin_ns + int(1e9 * SECONDS.get(fault, 3.0))
    bad = (wheels.t_ns >= begin_ns) & (wheels.t_ns < end_ns)
    if fault == "silent":
        return replace(drive, odometry=Trajectory(wheels.t_ns[~bad], wheels.poses[~bad]))
    poses = [wheels.poses[0]]
    for k in range(1, len(bad)):
        step, seconds = between(wheels.poses[k - 1], wheels.poses[k]), (wheels.t_ns[k] - wheels.t_ns[k - 1]) / 1e9
        poses.append(compose(poses[-1], _wrong(step, fault, seconds) if bad[k] else step))
    return replace(drive, odometry=Trajectory(wheels.t_ns, np.array(poses)))


def _wrong(step: Array, fault: str, seconds: float) -> Array:
    """Return what wheels with a fault say of a step (3,)."""
    if fault == "slip":  # of one side
        return step + np.array([0.0, 0.0, SLIP_RAD_S * seconds])
    if fault == "spin":  # a lifted robot's wheels go on, whatever it does
        return np.array([0.0, -SPIN_M_S * seconds, 0.0])
    return {"stand still": 0.0, "double": 2.0, "half": 0.5}[fault] * step


def outcome(name: str, fault: str, begin_s: float, seed: int, observation: str) -> Outcome:
    """Return what becomes of a drive whose wheels err from `begin_s` after its first image on."""
    drive = drive_of(name)
    seconds = (drive.t_ns - drive.t_ns[0]) / 1e9
    kept = np.flatnonzero((seconds >= begin_s - BEFORE_S) & (seconds < begin_s + AFTER_S))
    first_ns, last_ns = drive.t_ns[kept[[0, -1]]]
    wheels = (drive.odometry.t_ns > first_ns - STEP_NS) & (drive.odometry.t_ns < last_ns + STEP_NS)
    track = Trajectory(drive.odometry.t_ns[wheels], drive.odometry.poses[wheels])
    edges, truth = [drive.edges[k] for k in kept], drive.truth[kept]
    part = replace(drive, t_ns=drive.t_ns[kept], edges=edges, truth=truth, odometry=track)
    begin_ns = int(part.t_ns[np.searchsorted(seconds[kept], begin_s)])
    robot = Localiser(drive.landmark_map, drive.camera, _config(drive, observation), seed)
    start = truth[0] + START_SIGMA * robot.rng.standard_normal(3)
    robot.start(np.append(start[:2], wrap_angle(start[2])), np.diag(START_SIGMA**2), int(part.t_ns[0]))
    found = [frame.located for frame in located(robot, faulty(part, fault, begin_ns))[0]]

    error = np.array([one.estimate.pose for one in found]) - truth
    error_m = np.hypot(error[:, 0], error[:, 1])
    wrong = (error_m > CORRECT_M) | (np.abs(wrap_angle(error[:, 2])) > CORRECT_RAD)
    sure, told = (np.array([test(one) for one in found]) for test in (_is_sure, lambda one: one.wheels_are_wrong))
    later = part.t_ns > begin_ns + 1e9 * SECONDS.get(fault, 3.0)
    back = int(np.flatnonzero(wrong[later]).max(initial=-1)) + 1
    rmse_m = float(np.sqrt((error_m**2).mean()))
    counts = int(told[~later].sum()), int(told[later].sum())
    return Outcome(rmse_m, float(error_m.max()), float((sure & wrong).mean()), back, counts)


def _is_sure(one) -> bool:
    return bool(one.p_correct > SURE)


def _config(drive: Drive, observation: str):
    return read_config(drive.config, [f"observation.kind={observation}"], drive.settings)


def main() -> None:
    options = arguments()
    names = ("log", "fault", "after s", "seed", "RMSE m", "worst m", "sure and wrong", "back after", "told")
    table = Table(*names, title=f"Faulty wheels, {options.observation}")
    for name, fault, begin_s, seed in cases(options):
        told = outcome(name, fault, begin_s, seed, options.observation)
        figures = (f"{told.rmse_m:.3f}", f"{told.worst_m:.2f}", f"{told.sure_and_wrong:.3f}", str(told.back))
        table.add_row(name, fault, f"{begin_s:g}", str(seed), *figures, "{}, {}".format(*told.told))
    Console(width=110).print(table)


def cases(options: argparse.Namespace) -> Iterator[tuple[str, str, float, int]]:
    """Yield log, fault, place and seed of every drive."""
    for name in filter(is_there, options.logs):
        for fault in options.faults:
            for begin_s in options.begin or BEGIN_S[name]:
                for seed in options.seeds:
                    yield name, fault, begin_s, seed


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", nargs="+", default=["house", "bookstore"], choices=list(BEGIN_S))
    parser.add_argument("--faults", nargs="+", default=list(FAULTS), choices=list(FAULTS))
    parser.add_argument(
        "--begin", nargs="+", type=float, help="seconds after the first image; by default three or four"
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--observation", default="line", choices=["line", "slope"])
    return parser.parse_args()


if __name__ == "__main__":
    main()
