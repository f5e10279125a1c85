"""Compare runs with the truth: what a replay wrote or returned, or any trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from localiser import evaluate, storage
from localiser.documents import plain_name, shown
from localiser.errors import InputError
from localiser.evaluate import Track
from localiser.geometry import Trajectory, between, compose

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


def evaluate_run(
    run: Path | str | Track, truth: Path | str | Trajectory | None = None, align: str | None = None
) -> dict[str, Any]:
    """Return the metrics of a run against the truth.

    run: its folder, a trajectory file (TUM, or a run's CSV), or the track of a replay. truth: true poses, or their file
    (TUM, or CSV `t_ns,x,z,heading`); a run's folder is judged by it in place of what it recorded. align: see `aligned`;
    a run's folder without `truth` is aligned with the true poses that it holds. Raises InputError.
    """
    if isinstance(run, Track):
        if truth is None:
            raise InputError("expected the true poses, found none", field="truth")
        return _judged(run, truth, "", align)
    path = Path(run)
    if path.is_file() and path.name != storage.LATEST:
        if truth is None:
            raise InputError("a trajectory file needs --truth FILE, found none", path=path)
        return _judged(_track(path), truth, path.stem, align)
    folder = storage.find_run(path)
    recorded = _checked(storage.read_json(folder / "metrics.json"), folder / "metrics.json")
    if (folder / "timing.json").is_file():
        recorded |= _checked(storage.read_json(folder / "timing.json"), folder / "timing.json")
    if truth is None:
        if align is None:
            return recorded
        truth = folder / "groundtruth.tum"
        if not truth.is_file():
            raise InputError("--align needs true poses, here or by --truth FILE, found none", path=truth)
    judged = _judged(storage.read_track(folder / "trajectory.csv"), truth, str(recorded.get("log")), align, recorded)
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
        huge = "one of more than 64 bits" if isinstance(value, int) and value.bit_length() > 64 else ""
        if value is not None and (isinstance(value, bool) or huge or not isinstance(value, kinds)):
            raise InputError(f"expected {expected} or null, found {huge or shown(value)}", path=path, field=name)
        if isinstance(value, str):
            recorded[name] = plain_name(value)
    return recorded


def _judged(
    track: Track, truth: Path | str | Trajectory, log: str, align: str | None, about: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    poses = truth if isinstance(truth, Trajectory) else storage.read_poses(Path(truth))
    poses = poses if align is None else aligned(track, poses, align)
    try:
        return evaluate.metrics(track, poses, log=log, about=about)
    except InputError as error:  # of what is in memory: no image in common
        raise InputError(error.problem, path=None if isinstance(truth, Trajectory) else truth) from None


def aligned(track: Track, truth: Trajectory, how: str) -> Trajectory:
    """Return the truth moved and turned into the frame of a run, which so keeps its covariances.

    how: "origin": by the first pose that both have; "se2": by all, the least squares of their distances. Raises
    InputError.
    """
    if how not in ("origin", "se2"):
        raise InputError(f"expected origin or se2, found {how!r}", field="--align")
    common = [index for index, t_ns in enumerate(track.t_ns) if truth.covers(int(t_ns))]
    if not common:
        return truth
    here, there = track.poses[common], truth.sampled(track.t_ns[common]).poses
    if how == "origin":
        return Trajectory(truth.t_ns, compose(compose(here[0], between(there[0], np.zeros(3))), truth.poses))
    ours, theirs = (poses[:, 0] - 1j * poses[:, 1] for poses in (here, there))  # anticlockwise, as headings are
    turn = np.array([0.0, 0.0, np.angle(np.vdot(theirs - theirs.mean(), ours - ours.mean()))])
    turn[:2] = here[:, :2].mean(axis=0) - compose(turn, np.append(there[:, :2].mean(axis=0), 0.0))[:2]
    return Trajectory(truth.t_ns, compose(turn, truth.poses))


def _track(path: Path) -> Track:
    if path.suffix == ".csv":
        return storage.read_track(path)
    trajectory = storage.read_poses(path)
    return Track.from_poses(trajectory.t_ns, trajectory.poses)
