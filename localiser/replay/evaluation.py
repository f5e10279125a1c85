"""Compare runs with the truth: what a replay wrote or returned, or any trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from localiser import evaluate, storage
from localiser.documents import plain_name, shown
from localiser.errors import InputError
from localiser.evaluate import Track
from localiser.geometry import Trajectory

NOT_IN_A_TRACK = (
    "edges_matched",
    "residuals",
    "distance_m",
    "speed_mean_m_s",
    "biases",
    "landmarks",
    "warnings",
    "complete",
    "frame_ms_median",
    "frame_ms_p95",
    "stage_ms",
)
"""What a run wrote of itself that no truth changes and that its trajectory file does not hold."""


def evaluate_run(run: Path | str | Track, truth: Path | str | Trajectory | None = None) -> dict[str, Any]:
    """Return the metrics of a run against the truth.

    run: its folder, a trajectory file (TUM, or a run's CSV), or the track of a replay. truth: true poses, or their file
    (TUM, or CSV `t_ns,x,z,heading`); a run's folder is judged by it in place of what it recorded. Raises InputError.
    """
    if isinstance(run, Track):
        if truth is None:
            raise InputError("expected the true poses, found none", field="truth")
        return _judged(run, truth, "")
    path = Path(run)
    if path.is_file() and path.name != storage.LATEST:
        if truth is None:
            raise InputError("a trajectory file needs --truth FILE, found none", path=path)
        return _judged(_track(path), truth, path.stem)
    folder = storage.find_run(path)
    recorded = _checked(storage.read_json(folder / "metrics.json"), folder / "metrics.json")
    if (folder / "timing.json").is_file():
        recorded |= _checked(storage.read_json(folder / "timing.json"), folder / "timing.json")
    if truth is None:
        return recorded
    judged = _judged(storage.read_track(folder / "trajectory.csv"), truth, str(recorded.get("log")), recorded)
    return judged | {key: recorded[key] for key in NOT_IN_A_TRACK if key in recorded}


def _checked(recorded: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return recorded metrics of which those that are shown have their types. Raises InputError."""
    for name, kinds, expected in (
        *((column.key, (int, float), "a number") for column in evaluate.COLUMNS),
        *((name, (str, int), "a text or an integer") for name in ("log", *evaluate.ABOUT)),
        ("frames", (int,), "an integer"),
    ):
        value = evaluate.figure_at(recorded, name)
        if name == "pauses" and isinstance(value, list):
            continue
        if value is not None and (isinstance(value, bool) or not isinstance(value, kinds)):
            raise InputError(f"expected {expected} or null, found {shown(value)}", path=path, field=name)
        if isinstance(value, str):
            recorded[name] = plain_name(value)
    return recorded


def _judged(
    track: Track, truth: Path | str | Trajectory, log: str, about: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    if isinstance(truth, Trajectory):
        return evaluate.metrics(track, truth, log=log, about=about)
    path = Path(truth)
    poses = _poses(path)
    try:
        return evaluate.metrics(track, poses, log=log, about=about)
    except InputError as error:  # of what is in memory: no image in common
        raise InputError(error.problem, path=path) from None


def _poses(path: Path) -> Trajectory:
    return storage.read_poses(path)


def _track(path: Path) -> Track:
    if path.suffix == ".csv":
        return storage.read_track(path)
    trajectory = storage.read_poses(path)
    return Track.from_poses(trajectory.t_ns, trajectory.poses)
