"""Build a landmark map from a log: edges, poses, landmarks, a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from localiser import mapping, motion, storage
from localiser.commands.map.edges import edges_of_log
from localiser.config import Config
from localiser.edges import Edges
from localiser.errors import InputError, OutputError
from localiser.geometry import Array, Increment, Trajectory, between, compose
from localiser.landmarks import LandmarkMap
from localiser.storage import Log

if TYPE_CHECKING:
    from localiser.commands.map.watch import MapWatch

TRUTH, ODOMETRY, SLAM = "truth", "odometry", "slam"
_KNOWN_TURN_RAD = 1e-3
"""How far poses that are said to be true may be off between two images: synchronisation, interpolation."""
_LEAST_SIGMA = np.array([1e-3, 1e-3, 5e-4])
"""Error of the wheels between two images even at a stand: right, backward (m), turn (rad)."""
_LEAST_EXPLAINED = 0.1
"""Share of a log's edges below which its landmarks may be chance: poses that are free bend to fit some clutter."""
_MOST_DRIFT_RAD = np.deg2rad(8.0)
"""Heading error of the wheels in a full turn that coarse bearings still tell from the next landmark; see the docs."""
_FEWEST_FRAMES = 2
_STANDING_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class MapBuilt:
    """A map, and how it came about.

    trajectory: robot poses at the frames used. edges: of those frames. built: all landmarks that were tried, of which
    the map holds those worth keeping. slam: what else was found out where poses were not known.
    """

    landmark_map: LandmarkMap
    trajectory: Trajectory
    edges: list[Edges]
    sightings: mapping.Sightings
    built: mapping.Built
    slam: mapping.Slam | None = None


def build_map(
    log: Log, poses: str, config: Config, progress: Callable[[], None], watch: MapWatch | None = None
) -> MapBuilt:
    """Return the map of a log; poses: `truth`, `odometry`, `slam`, or the path of a trajectory (TUM, CSV).

    watch: sees the map grow along these poses, or those of the wheels, while edges are found, and what comes out.
    Raises InputError when poses are missing, the robot stands still, or nothing is seen from two sides.
    """
    known = None if poses == SLAM else known_poses(log, poses)
    t_ns = np.array([frame.t_ns for frame in log.frames], dtype=np.int64)
    track = _odometry_in_map(log) if known is None else known
    inside = np.flatnonzero((t_ns >= track.t_ns[0]) & (t_ns <= track.t_ns[-1]))
    if len(inside) < _FEWEST_FRAMES:
        raise InputError(
            f"expected poses at two images at least, found poses from {track.t_ns[0]} to {track.t_ns[-1]} ns and "
            f"images from {t_ns[0]} to {t_ns[-1]} ns",
            path=log.path,
            field="--poses",
        )
    trajectory = track.sampled(t_ns[inside])
    _require_motion(log, trajectory)
    exact = poses not in (ODOMETRY, SLAM)
    turn_sigma = np.full(len(trajectory), _KNOWN_TURN_RAD) if exact else turn_sigmas(trajectory, config)
    if watch is not None:
        watch.begin(log, trajectory, turn_sigma, config.mapping)
    edges = edges_of_log(log, config.edges, progress, watch=None if watch is None else watch.frame)
    used = [edges[index] for index in inside]
    if known is None:
        built = _from_log_alone(log, trajectory, used, config)
    else:
        built = _from_known_poses(log, trajectory, used, config, turn_sigma, exact=exact, source=poses)
    if watch is not None:
        watch.finish(built)
    return built


def known_poses(log: Log, poses: str) -> Trajectory:
    """Return the robot's poses in the map frame, from the log's truth, its odometry, or a file. Raises InputError."""
    if poses == TRUTH:
        if log.groundtruth is None:
            raise InputError("the log has no true poses; expected another --poses", path=log.path, field="groundtruth")
        return log.groundtruth
    if poses == ODOMETRY:
        return _odometry_in_map(log)
    path = Path(poses)
    if not path.exists():
        raise InputError(
            f"expected {TRUTH}, {ODOMETRY}, {SLAM} or the path of a trajectory, found {poses!r}", field="--poses"
        )
    return storage.load_poses(path) if path.suffix == ".csv" else storage.load_tum(path)


def _odometry_in_map(log: Log) -> Trajectory:
    """Return the odometry moved so that it begins at the log's stated start, where it has one."""
    if log.start is None:
        return log.odometry
    first = log.odometry.at(log.start.t_ns)
    return Trajectory(log.odometry.t_ns, compose(log.start.mean, between(first, log.odometry.poses)))


def _require_motion(log: Log, trajectory: Trajectory) -> None:
    moved = trajectory.poses[:, :2] - trajectory.poses[0, :2]
    farthest = float(np.hypot(moved[:, 0], moved[:, 1]).max())
    if farthest < _STANDING_M:
        raise InputError(
            f"expected a robot that drives, found one that stays within {farthest:.3f} m: without motion an edge is "
            "seen from one side only, and its distance cannot be told",
            path=log.path,
        )


def _from_known_poses(
    log: Log,
    trajectory: Trajectory,
    edges: list[Edges],
    config: Config,
    turn_sigma: Array,
    *,
    exact: bool,
    source: str,
) -> MapBuilt:
    parameters = config.mapping
    cameras = log.camera.pose_in_map(trajectory.poses)
    sightings = mapping.Sightings.from_edges(edges, log.camera)
    _require_edges(log, sightings)
    sigma = mapping.measured_sigma(sightings, log.camera.focal_px, parameters)
    if exact and np.median(sigma) > mapping.COARSE_RAD:
        built = mapping.build_from_votes(sightings, cameras, sigma, parameters)
    else:
        track = mapping.follow(sightings, cameras, turn_sigma, parameters.tracks)
        built = mapping.build_from_poses(sightings, track, cameras, sigma, parameters)
    source = source if source in (TRUTH, ODOMETRY) else Path(source).name
    landmark_map = mapping.landmark_map_of(
        sightings, built, cameras, sigma, log.camera, parameters, log.name, f"{log.name}, poses: {source}"
    )
    _require_landmarks(log, landmark_map, sightings, built, parameters)
    return MapBuilt(landmark_map, trajectory, edges, sightings, built)


def _from_log_alone(log: Log, odometry: Trajectory, edges: list[Edges], config: Config) -> MapBuilt:
    """Build from edges and odometry (T, 3), which begins at the log's stated start, or where it says itself."""
    parameters = config.mapping
    sightings = mapping.Sightings.from_edges(edges, log.camera)
    _require_edges(log, sightings)
    wheels = wheels_of(log.odometry, odometry.t_ns, config)
    require_association(log.path, sightings, wheels)
    found = mapping.build_from_log(sightings, wheels, odometry.poses[0], log.camera, parameters)
    cameras = found.camera.pose_in_map(found.poses)
    landmark_map = mapping.landmark_map_of(
        sightings, found.built, cameras, found.sigma, found.camera, parameters, log.name, f"{log.name}, poses: {SLAM}"
    )
    _require_landmarks(log, landmark_map, sightings, found.built, parameters)
    trajectory = Trajectory(odometry.t_ns, found.poses)
    return MapBuilt(landmark_map, trajectory, edges, sightings, found.built, found)


def wheels_of(odometry: Trajectory, t_ns: NDArray[np.int64], config: Config) -> mapping.Wheels:
    """Return what the wheels say of the motion between the times (T,), with its errors by the motion model."""
    poses = odometry.sampled(t_ns).poses
    moves = between(poses[:-1], poses[1:])
    steps = between(odometry.poses[:-1], odometry.poses[1:])
    path_m = _way(odometry, np.hypot(steps[:, 0], steps[:, 1]), t_ns)
    turned = _way(odometry, np.abs(steps[:, 2]), t_ns)
    model = config.motion
    distance = np.sqrt(model.alpha3 * path_m + model.alpha4 * turned)
    turn = np.sqrt(model.alpha1 * turned + model.alpha2 * path_m)
    # A turn of unknown place on the way moves the robot sideways by half of what it would at the start.
    sigma = np.stack([path_m * turn / 2, distance, turn], axis=-1)
    backwards = moves[:, 1] > 0
    return mapping.Wheels(moves, np.where(backwards, -path_m, path_m), np.hypot(sigma, _LEAST_SIGMA))


def _way(odometry: Trajectory, step: Array, t_ns: NDArray[np.int64]) -> Array:
    """Return how much of `step` (T' - 1,), made between poses of the odometry, lies between the times (T,)."""
    whole = np.concatenate([[0.0], np.cumsum(step)])
    seconds = (odometry.t_ns - odometry.t_ns[0]) / 1e9
    return np.asarray(np.diff(np.interp((t_ns - odometry.t_ns[0]) / 1e9, seconds, whole)))


def turn_sigmas(trajectory: Trajectory, config: Config) -> Array:
    """Return by how much (T,) rad the turn since the frame before may be off, for poses from odometry."""
    moves = between(trajectory.poses[:-1], trajectory.poses[1:])
    turns = [motion.noise_variances(Increment.from_mean(move), config.motion)[1] for move in moves]
    return np.hypot(_KNOWN_TURN_RAD, np.sqrt([0.0, *turns]))


def _require_edges(log: Log, sightings: mapping.Sightings) -> None:
    if len(sightings) == 0:
        raise InputError(
            f"expected vertical edges in the images, found none in {sightings.frames} of them", path=log.path
        )


def require_association(path: Path, sightings: mapping.Sightings, wheels: mapping.Wheels) -> None:
    """Raise InputError when bearings are too coarse, and wheels too bad, to tell which landmark was seen.

    A robot meets its landmarks again when it has turned round. Coarse bearings (median over `mapping.COARSE_RAD`) are
    not followed from image to image reliably, so that wheels must say by then which landmark is which.
    """
    sigma = float(np.median(sightings.sigma))
    drift = turn_drift(wheels)
    if sigma > mapping.COARSE_RAD and drift > _MOST_DRIFT_RAD:
        raise InputError(
            f"expected bearings good to {np.rad2deg(mapping.COARSE_RAD):g}°, or wheels whose heading is good to "
            f"{np.rad2deg(_MOST_DRIFT_RAD):g}° after a full turn; found {np.rad2deg(sigma):.1f}° and "
            f"{np.rad2deg(drift):.0f}° (motion.alpha1, motion.alpha2): nothing tells which landmark was seen, and the "
            f"map would be wrong; --poses {TRUTH} or the trajectory of another program makes one",
            path=path,
            field="--poses",
        )


def turn_drift(wheels: mapping.Wheels) -> float:
    """Return how far (rad, one sigma) the wheels' heading is off after a full turn, or at the end if that is sooner."""
    turned = float(np.abs(wheels.motion[:, 2]).sum())
    return float(np.sqrt((wheels.sigma[:, 2] ** 2).sum() * min(1.0, 2 * np.pi / max(turned, 1e-9))))


def _require_landmarks(
    log: Log,
    landmark_map: LandmarkMap,
    sightings: mapping.Sightings,
    built: mapping.Built,
    parameters: mapping.MappingParameters,
) -> None:
    """Raise InputError unless there are landmarks, and they explain more of the edges than chance might."""
    if not len(landmark_map):
        raise nothing_built(log, built, parameters)
    assert landmark_map.quality is not None
    explained = float(landmark_map.quality.sightings.sum()) / len(sightings)
    if explained >= _LEAST_EXPLAINED:
        return
    narrow = (built.count >= parameters.sightings_min) & (np.rad2deg(built.parallax) < parameters.parallax_min_deg)
    one_sided = float(built.count[narrow].sum()) / len(sightings)
    if one_sided > 0.5:
        raise _too_little_parallax(log, parameters, f"that {100 * one_sided:.0f} % of the edges are not")
    raise InputError(
        f"expected edges that belong to landmarks, found {len(landmark_map)} that explain {100 * explained:.0f} % "
        "of the edges: what the images show is clutter, or the poses do not fit them",
        path=log.path,
    )


def nothing_built(log: Log, built: mapping.Built, parameters: mapping.MappingParameters) -> InputError:
    """Return the error that says why no landmark came out."""
    followed = built.count >= parameters.sightings_min
    if not followed.any():
        most = int(built.count.max(initial=0))
        return InputError(
            f"expected edges that stay from image to image, found none in {parameters.sightings_min} of them "
            f"(at most {most}): what the images show is clutter, or too few of them overlap",
            path=log.path,
        )
    widest = float(np.rad2deg(built.parallax[followed].max()))
    if widest < parameters.parallax_min_deg:
        return _too_little_parallax(log, parameters, f"at most {widest:.1f}°")
    return InputError(
        "expected edges that are found again where they should be, found none likely enough to exist: what the images "
        "show is clutter, or the poses do not fit them",
        path=log.path,
    )


def _too_little_parallax(log: Log, parameters: mapping.MappingParameters, found: str) -> InputError:
    return InputError(
        f"expected edges seen from directions {parameters.parallax_min_deg:g}° apart, found {found}: "
        "too little parallax to tell distances; drive past things, not only towards them",
        path=log.path,
    )


def save(built: MapBuilt, path: Path, *, overwrite: bool) -> None:
    """Write the map. Raises OutputError when the file exists and is not to be overwritten, or cannot be written."""
    require_writable(path, overwrite=overwrite)
    storage.save_map(replace(built.landmark_map, header=_header(built)), path)


def require_writable(path: Path, *, overwrite: bool) -> None:
    """Raise OutputError when there is a file at `path` that is not to be overwritten."""
    if path.is_dir():
        raise OutputError(f"{path}: expected the name of a file, found a folder")
    if path.exists() and not overwrite:
        raise OutputError(f"{path}: exists already; --force overwrites it")


def _header(built: MapBuilt) -> dict[str, object]:
    return {"built_from_frames": len(built.trajectory)}
