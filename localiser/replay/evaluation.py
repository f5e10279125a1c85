"""Judge runs: what replay wrote, or any trajectory with the truth beside it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from localiser import evaluate, storage
from localiser.errors import InputError
from localiser.evaluate import Track
from localiser.geometry import Trajectory


def evaluate_run(path: Path | str, truth: Path | str | None = None) -> dict[str, Any]:
    """Return the metrics of a run's folder, or of a trajectory file (TUM, or a run's CSV) against the truth in a file.

    truth: true poses (TUM, or CSV `t_ns,x,z,heading`); a run's folder is judged by it in place of what it recorded.
    Raises InputError.
    """
    path = Path(path)
    if path.is_file() and path.name != storage.LATEST:
        if truth is None:
            raise InputError("a trajectory file needs --truth FILE, found none", path=path)
        return _judged(_track(path), Path(truth), path.stem)
    run = storage.find_run(path)
    recorded = storage.read_json(run / "metrics.json")
    if truth is None:
        return recorded
    return _judged(storage.read_track(run / "trajectory.csv"), Path(truth), str(recorded.get("log")), recorded)


def _judged(track: Track, truth: Path, log: str, about: Mapping[str, Any] | None = None) -> dict[str, Any]:
    poses = _poses(truth)
    try:
        return evaluate.metrics(track, poses, log=log, about=about)
    except InputError as error:  # of what is in memory: no image in common
        raise InputError(error.problem, path=truth) from None


def _poses(path: Path) -> Trajectory:
    return storage.read_poses(path) if path.suffix == ".csv" else storage.read_tum(path)


def _track(path: Path) -> Track:
    if path.suffix == ".csv":
        return storage.read_track(path)
    trajectory = storage.read_tum(path)
    return Track.from_poses(trajectory.t_ns, trajectory.poses)
