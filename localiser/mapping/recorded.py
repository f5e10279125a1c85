"""What is read of a recorded log: known poses, wheels between images, and the edges of its images, kept in a cache."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from localiser import camera as camera_module
from localiser import edges as edges_package
from localiser import geometry as geometry_package
from localiser import motion
from localiser.camera import Camera
from localiser.documents import decode, encode
from localiser.edges import EdgeParameters, Edges, find_edges
from localiser.errors import InputError
from localiser.filter import Sighting, Start
from localiser.geometry import Array, Increment, Trajectory, Twist, between, bridged, compose, read_kept, write_kept
from localiser.landmarks import LandmarkMap
from localiser.mapping.factors import Steps
from localiser.motion import MotionParameters

# -- poses and wheels -------------------------------------------------------------------------------------------------

TRUTH, ODOMETRY, SLAM = "truth", "odometry", "slam"
KNOWN_TURN_RAD = 1e-3
"""How far poses that are said to be true may be off between two images: synchronisation, interpolation."""
_LEAST_SIGMA = np.array([1e-3, 1e-3, 5e-4])
"""Error of the wheels between two images even at a stand: right, backward (m), turn (rad)."""


class RecordedLog(Protocol):
    """A log as `storage.Log` has it: frames are images, read when asked for, or edges that were measured already."""

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
    def frames(self) -> Sequence[Any]: ...  # noqa: D102
    @property
    def has_images(self) -> bool: ...  # noqa: D102
    def twist_at(self, t_ns: int) -> Twist | None: ...  # noqa: D102


def default_poses(logs: Sequence[RecordedLog]) -> str:
    """Return what the poses of logs are taken from where nobody says it."""
    return SLAM if len(logs) == 1 and logs[0].groundtruth is None else TRUTH


def known_poses(log: RecordedLog, poses: str) -> Trajectory:
    """Return the robot's poses in the map frame by the log's `truth` or `odometry`. Raises InputError.

    Odometry is moved so that it begins at the log's stated start, where it has one.
    """
    if poses == TRUTH:
        if log.groundtruth is None:
            problem = "the log has no true poses; expected another --poses, such as the trajectory of a replay"
            raise InputError(problem, path=log.path, field="groundtruth")
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


def wheels_of(odometry: Trajectory, t_ns: NDArray[np.int64], parameters: MotionParameters) -> Steps:
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
    cov = np.array([motion.covariance_of(noise_only, increment) for increment in whole]) + np.diag(_LEAST_SIGMA**2)
    return Steps(moves, np.where(moves[:, 1] > 0, -path_m, path_m), cov)


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


# -- where the drive of a map began -----------------------------------------------------------------------------------

DRIVE = "drive"
_SAME_M = 0.01


def drive_header(log: RecordedLog, trajectory: Trajectory) -> dict[str, Any]:
    """Return what a map says of the drive that it was built from, and where that began: see `start_on_map`."""
    pose, begin_ns = trajectory.poses[0], int(trajectory.t_ns[0])
    if log.odometry.covers(begin_ns):  # the pose at the first image, which may be earlier
        first_ns = max(log.frames[0].t_ns, int(log.odometry.t_ns[0]))
        pose = compose(pose, between(log.odometry.at(begin_ns), log.odometry.at(first_ns)))
    return {
        "log": log.name,
        "first_image_ns": int(log.frames[0].t_ns),
        "last_image_ns": int(log.frames[-1].t_ns),
        "odometry_m": round(_driven_m(log), 3),
        "start": {"x": float(pose[0]), "z": float(pose[1]), "heading_deg": float(np.rad2deg(pose[2]))},
    }


def start_on_map(landmark_map: LandmarkMap, log: RecordedLog) -> Array | None:
    """Return the pose (3,) at which a log begins on a map that was built from it; None on the map of another drive.

    It is the same drive when its images begin and end at the same times, and its wheels drove as far.
    """
    drive = landmark_map.header.get(DRIVE)
    if drive is None or (drive["first_image_ns"], drive["last_image_ns"]) != (log.frames[0].t_ns, log.frames[-1].t_ns):
        return None
    if abs(drive["odometry_m"] - _driven_m(log)) > _SAME_M:
        return None
    start = drive["start"]
    return np.array([start["x"], start["z"], np.deg2rad(start["heading_deg"])])


def _driven_m(log: RecordedLog) -> float:
    return float(np.hypot(*np.diff(log.odometry.poses[:, :2], axis=0).T).sum())


# -- edges ------------------------------------------------------------------------------------------------------------

# What was rejected is only looked at; a map is not built from it.
_KEPT = [field.name for field in fields(Edges) if field.name not in ("rejected_px", "height_sigma_m")]
_KEPT_LOGS = 50


def edges_of_log(
    log: RecordedLog, parameters: EdgeParameters, progress: Callable[[], None] = lambda: None, cache: Path | None = None
) -> list[Edges]:
    """Return the edges of every frame of a log. Raises InputError for a bad image.

    progress: is called after each frame. cache: a folder that only this user can write to, such as
    `private_folder("edges")`, in which edges are kept and looked up by the images' bytes, the camera, the parameters
    and the program that finds edges; None: nothing is kept.
    """
    kept = cache / f"edges-{_key(log, parameters)}" if cache and log.has_images else None
    content = read_kept(kept) if kept else None
    if content is not None:
        found: list[Edges] = decode(list[Edges], content)
        for _ in found:
            progress()
        return found
    found = []
    for frame in log.frames:
        if isinstance(frame, Sighting):
            found.append(frame.edges)
        else:
            twist = log.twist_at(frame.t_ns)
            edges = find_edges(frame.load(), log.camera, parameters, mount=frame.mount, twist=twist)
            found.append(Edges(**{name: getattr(edges, name) for name in _KEPT}))
        progress()
    if kept:
        write_kept(kept, encode(found), _KEPT_LOGS)
    return found


def _key(log: RecordedLog, parameters: EdgeParameters) -> str:
    """Return a digest of all that the edges depend on."""
    digest = hashlib.sha256()
    packages = (edges_package.__file__, geometry_package.__file__)
    sources = [path for each in packages for path in sorted(Path(str(each)).parent.rglob("*.py"))]
    for source in (*sources, Path(camera_module.__file__), Path(encode.__code__.co_filename)):
        digest.update(source.read_bytes())
    values = {field.name: getattr(log.camera, field.name) for field in fields(log.camera)}
    digest.update(repr((sorted(values.items(), key=lambda item: item[0]), parameters)).encode())
    for frame in log.frames:
        if not isinstance(frame, Sighting):
            digest.update(repr((frame.mount, log.twist_at(frame.t_ns))).encode())
            digest.update(hashlib.sha256(frame.encoded()).digest())
    return digest.hexdigest()[:40]
