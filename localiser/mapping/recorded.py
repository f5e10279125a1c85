"""What is read of a recorded log: known poses, wheels between images, and the edges of its images, kept in a cache."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from localiser import camera as camera_module
from localiser import edges as edges_package
from localiser import geometry as geometry_package
from localiser import motion
from localiser.camera import Camera, Mount
from localiser.documents import drafted
from localiser.edges import CommonError, EdgeParameters, Edges, find_edges
from localiser.errors import InputError, OutputError
from localiser.filter import Sighting, Start
from localiser.geometry import Array, Increment, Trajectory, Twist, between, bridged, compose
from localiser.mapping.factors import Wheels
from localiser.motion import MotionParameters

# -- poses and wheels -------------------------------------------------------------------------------------------------

TRUTH, ODOMETRY, SLAM = "truth", "odometry", "slam"
KNOWN_TURN_RAD = 1e-3
"""How far poses that are said to be true may be off between two images: synchronisation, interpolation."""
_LEAST_SIGMA = np.array([1e-3, 1e-3, 5e-4])
"""Error of the wheels between two images even at a stand: right, backward (m), turn (rad)."""


class RecordedImage(Protocol):
    """An image of a log, read when it is asked for; encoded: the file as it is."""

    @property
    def t_ns(self) -> int: ...  # noqa: D102
    @property
    def load(self) -> Callable[[], NDArray[np.uint8]]: ...  # noqa: D102
    @property
    def encoded(self) -> Callable[[], bytes]: ...  # noqa: D102
    @property
    def mount(self) -> Mount | None: ...  # noqa: D102


class RecordedLog(Protocol):
    """A log as `storage.Log` has it: frames are images, or edges that were measured already."""

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
    def frames(self) -> Sequence[RecordedImage | Sighting]: ...  # noqa: D102
    def twist_at(self, t_ns: int) -> Twist | None: ...  # noqa: D102


def known_poses(log: RecordedLog, poses: str) -> Trajectory:
    """Return the robot's poses in the map frame by the log's `truth` or `odometry`. Raises InputError.

    Odometry is moved so that it begins at the log's stated start, where it has one.
    """
    if poses == TRUTH:
        if log.groundtruth is None:
            raise InputError("the log has no true poses; expected another --poses", path=log.path, field="groundtruth")
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


def wheels_of(odometry: Trajectory, t_ns: NDArray[np.int64], parameters: MotionParameters) -> Wheels:
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
    cov = np.array([motion.wheel_cov(increment, noise_only) for increment in whole]) + np.diag(_LEAST_SIGMA**2)
    return Wheels(moves, np.where(moves[:, 1] > 0, -path_m, path_m), cov)


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


# -- edges ------------------------------------------------------------------------------------------------------------

# What was rejected is only looked at; a map is not built from it.
_WHOLE = ("common", "rejected_px", "mount", "height_sigma_m")  # of an image, not of each edge
_COLUMNS = tuple(field.name for field in fields(Edges) if field.name not in _WHOLE)
_SHARED = ("bearing_from_lean", "bearing_from_line")
_PACKED = (*_COLUMNS, *_SHARED)
_OUR_NAME = re.compile(r"edges-[0-9a-f]{32}\.npz")
_KEPT_FILES = 50  # that the cache holds; the oldest go


def edges_of_log(
    log: RecordedLog,
    parameters: EdgeParameters,
    progress: Callable[[int, Edges], None] | None = None,
    cache: Path | None = None,
) -> list[Edges]:
    """Return the edges of every frame of a log. Raises InputError for a bad image.

    progress: gets the time and the edges of each frame as soon as they are known. cache: a folder, such as
    `cache_folder()`, in which edges are kept and looked up by the images' bytes, the camera, the parameters and the
    program that finds edges; None: nothing is kept.
    """
    found = []
    for t_ns, edges in _found(log, parameters, cache):
        found.append(edges)
        if progress is not None:
            progress(t_ns, edges)
    return found


def _found(log: RecordedLog, parameters: EdgeParameters, cache: Path | None) -> Iterator[tuple[int, Edges]]:
    """Yield time and edges of every frame; those of images are kept when all are found."""
    images: list[RecordedImage] = []
    for frame in log.frames:
        if isinstance(frame, Sighting):
            yield frame.t_ns, frame.edges
        else:
            images.append(frame)
    twists = [log.twist_at(image.t_ns) for image in images]
    path = cache / f"edges-{_key(images, twists, log.camera, parameters)}.npz" if cache and images else None
    known = _load(path, len(images)) if path else None
    if known is not None:
        for image, edges in zip(images, known, strict=True):
            yield image.t_ns, replace(edges, mount=image.mount)
        return
    found = []
    for image, twist in zip(images, twists, strict=True):
        edges = find_edges(image.load(), log.camera, parameters, mount=image.mount, twist=twist)
        found.append(Edges(**{name: getattr(edges, name) for name in _COLUMNS}, common=edges.common, mount=image.mount))
        yield image.t_ns, found[-1]
    if path and len({edges.common.names for edges in found if len(edges)}) <= 1:
        _save(path, found)


def cache_folder() -> Path:
    """Return where edges are kept: `$LOCALISER_CACHE/edges`, else `localiser/edges` in the user's cache folder."""
    if stated := os.environ.get("LOCALISER_CACHE"):
        return Path(stated) / "edges"
    user = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(user) / "localiser" / "edges"


def _key(
    images: Sequence[RecordedImage], twists: Sequence[Twist | None], camera: Camera, parameters: EdgeParameters
) -> str:
    """Return a digest of all that the edges depend on."""
    digest = hashlib.sha256()
    for source in _sources():
        digest.update(source.read_bytes())
    values = {field.name: getattr(camera, field.name) for field in fields(camera)}
    digest.update(repr((sorted(values.items(), key=lambda item: item[0]), parameters)).encode())
    for image, twist in zip(images, twists, strict=True):
        for part in (image.mount, twist):
            if part is not None:
                digest.update(repr(part).encode())
        digest.update(hashlib.sha256(image.encoded()).digest())
    return digest.hexdigest()[:32]


def _sources() -> list[Path]:
    """Return the files of the program that decide what is found: a change to one makes the cache old."""
    package = Path(str(edges_package.__file__)).parent
    return [
        *sorted(package.rglob("*.py")),
        Path(camera_module.__file__),
        *sorted(Path(str(geometry_package.__file__)).parent.rglob("*.py")),
    ]


def _save(path: Path, frames: Sequence[Edges]) -> None:
    """Write the edges whole or not at all. A cache that cannot be written is no reason to fail."""
    filled = [edges for edges in frames if len(edges)] or [Edges.none()]
    content = {name: np.concatenate([getattr(edges, name) for edges in filled]) for name in _COLUMNS}
    content |= {name: np.concatenate([getattr(edges.common, name) for edges in filled]) for name in _SHARED}
    content["cov"] = np.array([edges.common.cov for edges in filled])
    content["names"] = np.array(filled[0].common.names, dtype=str)
    content["count"] = np.array([len(edges) for edges in frames])
    with suppress(OutputError, OSError):
        with drafted(path) as draft, draft.open("xb") as file:
            np.savez(file, allow_pickle=False, **content)
        ours = [kept for kept in path.parent.glob("*.npz") if _OUR_NAME.fullmatch(kept.name)]
        for kept in sorted(ours, key=lambda kept: kept.stat().st_mtime)[:-_KEPT_FILES]:
            kept.unlink(missing_ok=True)


def _load(path: Path, frames: int) -> list[Edges] | None:
    """Return the edges of all frames; None when the file is missing or not what was written."""
    try:
        with np.load(path, allow_pickle=False) as content:
            columns: dict[str, Any] = {name: content[name] for name in content.files}
        count = columns["count"]
        whole = count.dtype.kind == "i" and len(count) == frames and (count >= 0).all()
        rows = max(int(count.sum()), 0) if whole else -1
        right = whole and all(len(columns[name]) == rows and columns[name].dtype.kind in "fiub" for name in _PACKED)
        return _unpacked(columns, count) if right or rows == 0 else None
    except Exception:  # whatever a damaged file makes of the readers of numpy and zip
        return None


def _unpacked(columns: dict[str, Any], count: np.ndarray) -> list[Edges]:
    names, first = tuple(map(str, columns["names"])), np.concatenate([[0], np.cumsum(count)])
    cov = iter(columns["cov"])
    result = []
    for begin, end in pairwise(first):
        if begin == end:
            result.append(Edges.none())
            continue
        common = CommonError(names, next(cov), *(columns[name][begin:end] for name in _SHARED))
        result.append(Edges(**{name: columns[name][begin:end] for name in _COLUMNS}, common=common))
    return result
