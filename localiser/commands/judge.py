"""Judge runs: what replay wrote, or any trajectory with the truth beside it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from localiser import evaluate, storage
from localiser.errors import InputError
from localiser.evaluate import Track
from localiser.geometry import Trajectory


def figures_of(path: Path, truth_path: Path | None) -> dict[str, Any]:
    """Return the metrics of a run's folder, or of a TUM file (or a trajectory.csv) against the truth in a file.

    With a truth given, a run's folder is judged against that instead of what it recorded. Raises InputError.
    """
    if path.is_file() and path.name != storage.LATEST:
        if truth_path is None:
            raise InputError("a trajectory file needs --truth FILE, found none", path=path)
        return _judged(_track(path), truth_path, path.stem)
    run = storage.find_run(path)
    if truth_path is None:
        return storage.load_json(run / "metrics.json")
    recorded = storage.load_json(run / "metrics.json")
    track = storage.load_track(run / "trajectory.csv")
    return _judged(track, truth_path, str(recorded.get("log")), recorded)


def _judged(track: Track, truth_path: Path, log: str, about: Mapping[str, Any] | None = None) -> dict[str, Any]:
    truth = load_truth(truth_path)
    try:
        return evaluate.metrics(track, truth, log=log, about=about)
    except InputError as error:  # of what is in memory: no image in common
        raise InputError(error.problem, path=truth_path) from None


def load_truth(path: Path) -> Trajectory:
    """Return the truth in a TUM file, or in a CSV of the log's form (`t_ns,x,z,heading`). Raises InputError."""
    return storage.load_poses(path) if path.suffix == ".csv" else storage.load_tum(path)


def _track(path: Path) -> Track:
    if path.suffix == ".csv":
        return storage.load_track(path)
    trajectory = storage.load_tum(path)
    return Track.from_poses(trajectory.t_ns, trajectory.poses)
