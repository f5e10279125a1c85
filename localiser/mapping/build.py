"""Build a landmark map from recorded logs: edges, poses, landmarks, and the quality of each landmark.

Robot poses are known (a truth, a trajectory, unchanged odometry), or they are found together with the map (SLAM).
Errors say why no map can be built, and how to get one: the robot does not move, there is too little parallax, there is
only clutter, or the bearings are too coarse.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol, cast

import numpy as np

from localiser.edges import EdgeParameters, Edges
from localiser.errors import InputError
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.mapping.factors import Prior
from localiser.mapping.known_poses import build_from_far_images, build_from_poses
from localiser.mapping.landmarks import Built, measured_sigma
from localiser.mapping.quality import landmark_map_of
from localiser.mapping.recorded import (
    DRIVE,
    KNOWN_TURN_RAD,
    ODOMETRY,
    SLAM,
    TRUTH,
    RecordedLog,
    default_poses,
    drive_header,
    edges_of_log,
    known_poses,
    turn_sigmas,
    wheels_of,
)
from localiser.mapping.sightings import Index, Sightings
from localiser.mapping.slam import Slam, build_from_log
from localiser.mapping.tracks import MappingParameters, follow
from localiser.markers import name_of
from localiser.motion import MotionParameters

# -- what can be mapped -----------------------------------------------------------------------------------------------

COARSE_RAD = np.deg2rad(0.5)
"""Bearings worse than this are off by 4 cm five metres away: neighbours are mixed from one image to the next."""
_LEAST_EXPLAINED = 0.1
"""Share of a log's edges below which its landmarks may be chance: poses that are free bend to fit some clutter."""
_STANDING_M = 0.05


def require_sharp(path: Path, sightings: Sightings) -> None:
    """Raise InputError when bearings are too coarse (median over `COARSE_RAD`) to follow edges from image to image."""
    sigma = float(np.median(sightings.sigma))
    if sigma > COARSE_RAD:
        raise InputError(
            f"expected bearings good to {np.rad2deg(COARSE_RAD):g}°, found {np.rad2deg(sigma):.1f}°: they do not tell "
            "neighbours apart from one image to the next; such logs need true poses and a builder in mapping.BUILDERS",
            path=path,
        )


def require_landmarks(
    log: RecordedLog, landmark_map: LandmarkMap, sightings: Sightings, built: Built, parameters: MappingParameters
) -> None:
    """Raise InputError unless there are landmarks, and they explain more of the edges than chance might."""
    explained = 0.0 if landmark_map.quality is None else float(landmark_map.quality.sightings.sum()) / len(sightings)
    if len(landmark_map) and explained >= _LEAST_EXPLAINED:
        return
    followed, widest = built.count >= parameters.sightings_min, np.rad2deg(built.parallax)
    one_sided = float(built.count[followed & (widest < parameters.parallax_min_deg)].sum()) / len(sightings)
    if not followed.any():
        problem = (
            f"expected edges that stay from image to image, found none in {parameters.sightings_min} of them "
            f"(at most {int(built.count.max(initial=0))}): what the images show is clutter, or too few of them overlap"
        )
    elif one_sided > 0.5 or widest[followed].max() < parameters.parallax_min_deg:
        problem = (
            f"expected edges seen from directions {parameters.parallax_min_deg:g}° apart, found that "
            f"{100 * one_sided:.0f} % of the edges are not (the widest: {widest[followed].max():.1f}°): "
            "too little parallax to tell distances; drive past things, not only towards them"
        )
    else:
        problem = (
            f"expected edges that belong to landmarks, found {len(landmark_map)} landmarks that explain "
            f"{100 * explained:.0f} % of the edges: what the images show is clutter, or the poses do not fit them"
        )
    raise InputError(problem, path=log.path)


# -- the whole way ----------------------------------------------------------------------------------------------------

_FEWEST_FRAMES = 2
_DEFAULTS = {"edges": EdgeParameters(), "motion": MotionParameters(), "mapping": MappingParameters()}


class BuildSettings(Protocol):
    """The parts of a configuration that building a map needs."""

    @property
    def edges(self) -> EdgeParameters: ...  # noqa: D102
    @property
    def motion(self) -> MotionParameters: ...  # noqa: D102
    @property
    def mapping(self) -> MappingParameters: ...  # noqa: D102


@dataclass(frozen=True, slots=True, eq=False)
class MapBuilt:
    """A map, and how it came about.

    trajectory: robot poses at the frames used. sightings: the edges of these. built: all landmarks that were tried;
    kept: (L,) which of them the map holds. edges: of all images of each log. slam: what else was found out where poses
    were not known.
    """

    landmark_map: LandmarkMap
    kept: Index
    trajectory: Trajectory
    sightings: Sightings
    built: Built
    edges: Sequence[Sequence[Edges]]
    slam: Slam | None = None


class Builder(Protocol):
    """Makes landmarks of edges that are seen from poses which are known exactly; None where it is for other logs."""

    def __call__(
        self, paths: Sequence[Array], sightings: Sightings, sigma: Array, parameters: MappingParameters
    ) -> tuple[Built, Array | None] | None:
        """Return the landmarks (L), and how likely each exists (L,) where that is known.

        paths: camera poses (T, 3) of each log, one after the other those of the frames. sigma: (S,) rad.
        """


BUILDERS: list[Builder] = [build_from_far_images]
"""For poses that are known exactly: the first that suits is used, else edges are followed from image to image.

Insert a `Builder` for others.
"""


def build_map(
    log: RecordedLog | Sequence[RecordedLog],
    poses: str | Trajectory | None = None,
    config: BuildSettings | None = None,
    *,
    edges_of: Callable[[Any], Sequence[Edges]] | None = None,
    source: str = "a trajectory",
) -> MapBuilt:
    """Return the landmark map of a log, or of several by their truth. Nothing is written.

    poses: `truth`, `odometry`, `slam`, or the robot's poses in the map; by default the truth, `slam` for a log that has
    none. source: what poses are called in the map. Several logs share one frame; the trajectory of the result is that
    of the first. edges_of: gives the edges of every image of a log, by default `edges_of_log`; it is asked once poses
    are known. Raises InputError when poses are missing, the robot stands still, or nothing is seen from two sides.
    """
    config = config or cast("BuildSettings", SimpleNamespace(**_DEFAULTS))
    logs = list(log) if isinstance(log, Sequence) else [log]
    poses = default_poses(logs) if poses is None else poses
    name = poses if isinstance(poses, str) else source
    if len(logs) > 1 and poses != TRUTH:
        problem = f"expected {TRUTH} for several logs, which must share one frame, found {name!r}"
        raise InputError(problem, field="--poses")
    seen = [_seen(each, poses, config, edges_of) for each in logs]
    first, parameters, slam, probability = seen[0], config.mapping, None, None
    trajectory = first.trajectory
    if poses == SLAM:
        wheels = wheels_of(first.log.odometry, trajectory.t_ns, config.motion)
        require_sharp(first.log.path, first.sightings)
        prior = Prior.of(config.motion)
        slam = build_from_log(first.sightings, wheels, prior, trajectory.poses[0], first.log.camera, parameters)
        trajectory = Trajectory(trajectory.t_ns, slam.poses)
        sightings, cameras, sigma, built = first.sightings, slam.cameras, slam.sigma, slam.built
    else:
        sightings, cameras, sigma, built, probability = _along(seen, parameters, exact=poses != ODOMETRY)
    names = " + ".join(each.name for each in logs)
    landmark_map = landmark_map_of(
        sightings,
        built,
        cameras,
        sigma,
        logs[0].camera,
        parameters,
        names,
        f"{names}, poses: {name}",
        probability=probability,
    )
    require_landmarks(logs[0], landmark_map, sightings, built, parameters)
    header: dict[str, Any] = {"built_from_frames": sightings.frames}
    if len(logs) == 1:
        header |= {DRIVE: drive_header(logs[0], trajectory)}
    kept = np.array(landmark_map.ids, dtype=np.int64)
    extra = _identities(sightings, built, kept, config.edges.markers)
    landmark_map = replace(landmark_map, ids=tuple(range(len(kept))), header=header, extra=extra)
    return MapBuilt(landmark_map, kept, trajectory, sightings, built, [one.edges for one in seen], slam)


def _identities(sightings: Sightings, built: Built, kept: Index, dictionary: str) -> tuple[dict[str, Any], ...]:
    """Return what the landmarks at `kept` (K,) are called: as the side of a marker that most images show there."""
    extra: tuple[dict[str, Any], ...] = tuple({} for _ in kept)
    for own, landmark in zip(extra, kept, strict=True):
        codes, count = np.unique(sightings.marker[built.of == landmark], return_counts=True)
        told = codes < -1
        if told.any() and 2 * count[told].max() > count[told].sum():
            own["identity"] = name_of(int(codes[told][count[told].argmax()]), dictionary)
    return extra


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What was seen of one log. trajectory: robot poses at the images used. turn_sigma: (T,) rad, of their turns.

    edges: of all images. sightings: those of the images used.
    """

    log: RecordedLog
    trajectory: Trajectory
    turn_sigma: Array
    edges: Sequence[Edges]
    sightings: Sightings

    @property
    def cameras(self) -> Array:
        return self.sightings.camera_poses(self.log.camera, self.trajectory.poses)


def _seen(
    log: RecordedLog,
    poses: str | Trajectory,
    config: BuildSettings,
    edges_of: Callable[[Any], Sequence[Edges]] | None,
) -> _Seen:
    """Return the edges of the images of a log, and where they were seen from. Raises InputError."""
    known = known_poses(log, ODOMETRY if poses == SLAM else poses) if isinstance(poses, str) else poses
    t_ns = np.array([frame.t_ns for frame in log.frames], dtype=np.int64)
    inside: Index = np.flatnonzero((t_ns >= known.t_ns[0]) & (t_ns <= known.t_ns[-1]))
    if len(inside) < _FEWEST_FRAMES:
        raise InputError(
            f"expected poses at two images at least, found poses from {known.t_ns[0]} to {known.t_ns[-1]} ns and "
            f"images from {t_ns[0]} to {t_ns[-1]} ns",
            path=log.path,
            field="--poses",
        )
    trajectory = known.sampled(t_ns[inside])
    farthest = float(np.hypot(*(trajectory.poses - trajectory.poses[0])[:, :2].T).max())
    if farthest < _STANDING_M:
        raise InputError(
            f"expected a robot that drives, found one that stays within {farthest:.3f} m: without motion an edge is "
            "seen from one side only, and its distance cannot be told",
            path=log.path,
        )
    exact = poses not in (ODOMETRY, SLAM)
    turn_sigma = np.full(len(trajectory), KNOWN_TURN_RAD) if exact else turn_sigmas(trajectory, config.motion)
    edges = edges_of(log) if edges_of else edges_of_log(log, config.edges)
    sightings = Sightings.from_edges([edges[index] for index in inside], log.camera)
    if len(sightings) == 0:
        raise InputError(
            f"expected vertical edges in the images, found none in {sightings.frames} of them", path=log.path
        )
    return _Seen(log, trajectory, turn_sigma, edges, sightings)


def _along(
    seen: Sequence[_Seen], parameters: MappingParameters, *, exact: bool
) -> tuple[Sightings, Array, Array, Built, Array | None]:
    """Return edges, camera poses (T, 3), sigmas (S,), landmarks (L) and their probabilities (L,), by known poses.

    exact: poses are known and not from odometry.
    """
    paths = [one.cameras for one in seen]
    sigma = np.concatenate([measured_sigma(one.sightings, one.log.camera.focal_px, parameters) for one in seen])
    cameras, sightings = np.concatenate(paths), seen[0].sightings
    if len(seen) > 1:
        sightings = Sightings.together([one.sightings for one in seen], [one.log.camera for one in seen])
    for builder in BUILDERS if exact else []:
        if made := builder(paths, sightings, sigma, parameters):
            return sightings, cameras, sigma, *made
    require_sharp(seen[0].log.path, sightings)
    tracks: list[Index] = []
    for one, path in zip(seen, paths, strict=True):
        count = 1 + max((int(track.max(initial=-1)) for track in tracks), default=-1)
        tracks.append(count + follow(one.sightings, path, one.turn_sigma, parameters.tracks))
    built = build_from_poses(sightings, np.concatenate(tracks), cameras, sigma, parameters)
    return sightings, cameras, sigma, built, None
