"""The drives that the belief is judged on: logs with their edges found once a process, and drives cut and joined."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import scenarios
from belief_run import CORRECT_RAD, Drive
from mrclam import MrclamReader
from numpy.typing import NDArray
from scenarios import IMAGES, Trial

from localiser import ImageEvent, Trajectory, compose, find_edges, open_log, read_config, wrap_angle
from localiser.geometry import Array, between
from localiser.storage.log import ReadOptions

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("LOCALISER_DATA", ROOT.parent / "shared" / "data"))
LOGS = ("corridor", "office", "house", "bookstore")
NAMES = {*LOGS, "mrclam"}
SHIPPED = {"corridor": ROOT / "logs" / "corridor"}
MRCLAM = ROOT / "configs" / "mrclam.yaml"
STEP_NS = 200_000_000


def is_there(name: str) -> bool:
    """Whether the data of a drive is there."""
    return name == "office" or _folder(name).exists()


@cache
def drive_of(name: str) -> Drive:
    """Return a log by its name; of images the edges. The office's are simulated, as rendering takes minutes."""
    if name == "office":
        place = scenarios.place_of("office", scenarios.IMAGE_SHELVES["office"], both_ways=False)
        return drive_of_trial("office", scenarios.trial_of(place, np.arange(len(place.truth)), 0, IMAGES))
    if name.startswith("mrclam"):
        sensor = read_config(MRCLAM).sensor
        log = MrclamReader().read(Path(f"{_folder(name)}:{name[-1]}"), ReadOptions(sensor))
        return _drive(name, log, MRCLAM)
    return _drive(name, open_log(_folder(name)))


def drive_of_trial(name: str, trial: Trial) -> Drive:
    """Return a trial of `scenarios.py` as a drive."""
    truth = trial.truth
    return Drive(
        name,
        trial.landmark_map,
        trial.camera,
        trial.odometry,
        truth.t_ns,
        trial.frames,
        truth.poses,
        carried=trial.carried,
    )


def spliced(drive: Drive, until: int, then: int, images: int) -> Drive:
    """Return a drive to image `until` and on from image `then`, `images` of them; the wheels miss what is between."""
    first, second = drive.t_ns[until], drive.t_ns[then]
    last = drive.t_ns[min(then + images, len(drive.t_ns)) - 1]
    wheels, shift = drive.odometry, first + STEP_NS - second
    before = (wheels.t_ns > drive.t_ns[0] - STEP_NS) & (wheels.t_ns < first)
    after = (wheels.t_ns > second) & (wheels.t_ns <= last + STEP_NS)
    here, there = (wheels.sampled([t]).poses[0] for t in (first, second))
    moved = compose(here, between(there, wheels.poses[after]))
    t_ns = np.concatenate([wheels.t_ns[before], [first, first + STEP_NS], wheels.t_ns[after] + shift])
    index = np.concatenate([np.arange(until + 1), np.arange(then, min(then + images, len(drive.t_ns)))])
    return replace(
        drive,
        odometry=Trajectory(t_ns, np.concatenate([wheels.poses[before], [here, here], moved])),
        t_ns=np.where(np.arange(len(index)) > until, drive.t_ns[index] + shift, drive.t_ns[index]),
        edges=[drive.edges[k] for k in index],
        truth=drive.truth[index],
        carried=until + 1,
    )


def carried(drive: Drive, seed: int, *, before: int = 60, after: int = 150, far_m: float = 2.0) -> Drive:
    """Return a drive of which the robot is carried to a place at least `far_m` away that it drives through too."""
    rng, count = np.random.default_rng([seed, 7]), len(drive.t_ns)
    after = min(after, count // 3)
    while True:
        first, then = rng.integers(0, count - before), int(rng.integers(0, count - after))
        until = int(first) + before - 1
        moved = between(drive.truth[until], drive.truth[then])
        if np.hypot(moved[0], moved[1]) >= far_m and abs(moved[2]) > 2 * CORRECT_RAD:
            break
    whole = spliced(drive, until, then, after)
    return _from(whole, int(first))


def elsewhere(drive: Drive, seed: int, far_m: float = 2.0) -> Array:
    """Return a pose (3,) of the drive at least `far_m` from its first one, turned at random: a start that is wrong."""
    rng = np.random.default_rng([seed, 8])
    distance = np.hypot(*(drive.truth[:, :2] - drive.truth[0, :2]).T)
    chosen = drive.truth[rng.choice(np.flatnonzero(distance >= far_m))]
    return np.array([*chosen[:2], wrap_angle(rng.uniform(-np.pi, np.pi))])


def _from(drive: Drive, first: int) -> Drive:
    """Return the drive from image `first` on."""
    index: NDArray[np.int64] = np.arange(first, len(drive.t_ns))
    later = drive.odometry.t_ns >= drive.t_ns[first] - STEP_NS
    return replace(
        drive,
        odometry=Trajectory(drive.odometry.t_ns[later], drive.odometry.poses[later]),
        t_ns=drive.t_ns[index],
        edges=drive.edges[first:],
        truth=drive.truth[index],
        carried=None if drive.carried is None else drive.carried - first,
    )


def _folder(name: str) -> Path:
    return SHIPPED.get(name, DATA / name.partition(" ")[0])


def _drive(name: str, log, config: Path | None = None) -> Drive:
    parameters = read_config(config, [], log.settings).edges
    edges = [
        find_edges(frame.load(), log.camera, parameters) if isinstance(frame, ImageEvent) else frame.edges
        for frame in log.frames
    ]
    t_ns = np.array([frame.t_ns for frame in log.frames], dtype=np.int64)
    truth = log.groundtruth.sampled(t_ns).poses
    return Drive(name, log.landmark_map, log.camera, log.odometry, t_ns, edges, truth, log.settings, config)
