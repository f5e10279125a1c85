"""Where a replay, or a live run, starts, and how a user or the system stops it between two images."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

import numpy as np

from localiser.errors import InputError
from localiser.filter import Start
from localiser.geometry import wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.mapping import start_on_map
from localiser.storage import Log

START_SIGMA = np.array([0.1, 0.1, np.deg2rad(3.0)])
"""How far a start that is given on the command line may be off: x, z (m), heading (rad), one sigma."""

FARTHEST = np.array([1e8, 1e8, 2 * np.pi])
"""The largest x, z (m) and heading (rad) that can be given, as in a log's start."""

TRUTH, GLOBAL = "truth", "global"


def start_of(
    log: Log, option: str | Start | None, rng: np.random.Generator, landmark_map: LandmarkMap | None = None
) -> Start | None:
    """Return the start of a replay at its first image; None for anywhere on the map.

    option: a start, `x,z,heading_deg`, `global` for anywhere, `truth` for the true pose plus a draw from
    N(0, `START_SIGMA`²), or None: as the log states, else where it began on a landmark map that was built from it.
    Raises InputError.
    """
    if isinstance(option, Start) or option == GLOBAL:
        return option if isinstance(option, Start) else None
    if option is None:
        return _own_start(log, landmark_map)
    first_ns = log.frames[0].t_ns
    return stated_start(_near_truth(log, first_ns, rng) if option == TRUTH else option, first_ns, landmark_map)


def has_start(log: Log, option: str | Start | None, landmark_map: LandmarkMap) -> bool:
    """Whether it is known where a replay starts; see `start_of`."""
    return option != GLOBAL and (option is not None or _own_start(log, landmark_map) is not None)


def _own_start(log: Log, landmark_map: LandmarkMap | None) -> Start | None:
    if log.start is not None or landmark_map is None:
        return log.start
    for one in landmark_map.maps:
        if (began := start_on_map(one, log)) is not None:
            return stated_start(began + landmark_map.origin(one.name), log.frames[0].t_ns)
    return None


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


def stated_start(pose: str | np.ndarray, t_ns: int = 0, landmark_map: LandmarkMap | None = None) -> Start:
    """Return a start at a pose (3,), or at that of `x,z,heading_deg`, to `START_SIGMA`. Raises InputError.

    landmark_map: where that may follow the name of one of several maps and a colon.
    """
    if isinstance(pose, str):
        name, _, numbers = pose.rpartition(":")
        if name and (landmark_map is None or len(landmark_map.maps) < 2):
            raise InputError(f"expected no name of a map where there is one map, found {pose!r}", field="--start")
        pose = given_pose(numbers) + (np.zeros(3) if landmark_map is None else landmark_map.origin(name))
    return Start(t_ns, pose, np.diag(START_SIGMA**2))


def given_pose(option: str) -> np.ndarray:
    """Return the pose (3,) of `x,z,heading_deg`. Raises InputError."""
    problem = f"expected x,z,heading_deg (metres and degrees, such as 1.5,-2,90), global or truth, found {option!r}"
    try:
        x, z, heading_deg = (float(part) for part in option.split(","))
    except ValueError:
        raise InputError(problem, field="--start") from None
    pose = np.array([x, z, np.deg2rad(heading_deg)])
    if not (np.abs(pose) <= FARTHEST).all():
        raise InputError(problem, field="--start")
    pose[2] = wrap_angle(pose[2])
    return pose


_SIGNALS = [signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]


class Stop(threading.Event):
    """Is set once the user, or the system, asks a run to stop. exit_code: how the program then ends, as shells do."""

    exit_code = 128 + signal.SIGINT


@contextmanager
def asked_to_stop() -> Iterator[Stop]:
    """Hold Ctrl-C, SIGTERM and SIGHUP back; yields an event that they set. A second one is not held back.

    A signal that is ignored, as SIGHUP under `nohup`, stays so. In other threads than the main one, which get no
    signals, nothing is changed.
    """
    asked = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def ask(number: int, _frame: FrameType | None) -> None:
        asked.exit_code = 128 + number
        asked.set()
        restore()

    held = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, ask) for number in held}
    try:
        yield asked
    finally:
        restore()
