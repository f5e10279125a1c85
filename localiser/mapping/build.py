"""Build a landmark map from a recorded log: edges, poses, landmarks, and the quality of each landmark.

Robot poses are known (a truth, a trajectory, unchanged odometry), or they are found together with the map (SLAM).
Errors say why no map can be built: the robot does not move, there is too little parallax, there is only clutter, or the
wheels are too inaccurate for the bearings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from localiser.edges import EdgeParameters, Edges
from localiser.errors import InputError
from localiser.geometry import Array, Trajectory
from localiser.landmarks import LandmarkMap
from localiser.mapping.coarse_bearings import COARSE_RAD
from localiser.mapping.factors import Prior
from localiser.mapping.far_images import are_far, build_from_far_images
from localiser.mapping.from_known_poses import build_from_coarse, build_from_poses
from localiser.mapping.landmarks import Built, measured_sigma
from localiser.mapping.log_edges import edges_of_log
from localiser.mapping.mappable import require_association, require_landmarks, require_motion
from localiser.mapping.parameters import MappingParameters
from localiser.mapping.quality import landmark_map_of
from localiser.mapping.recorded import (
    KNOWN_TURN_RAD,
    ODOMETRY,
    SLAM,
    TRUTH,
    RecordedLog,
    known_poses,
    turn_sigmas,
    wheels_of,
)
from localiser.mapping.sightings import Index, Sightings
from localiser.mapping.slam import Slam, build_from_log
from localiser.mapping.tracks import follow
from localiser.motion import MotionParameters

_FEWEST_FRAMES = 2


class BuildSettings(Protocol):
    """The parts of a configuration that building a map needs."""

    @property
    def edges(self) -> EdgeParameters: ...  # noqa: D102
    @property
    def motion(self) -> MotionParameters: ...  # noqa: D102
    @property
    def mapping(self) -> MappingParameters: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class BuildParameters:
    """The settings of a build where there is no whole configuration."""

    edges: EdgeParameters = field(default_factory=EdgeParameters)
    motion: MotionParameters = field(default_factory=MotionParameters)
    mapping: MappingParameters = field(default_factory=MappingParameters)


@dataclass(frozen=True, slots=True, eq=False)
class MapBuilt:
    """A map, and how it came about.

    trajectory: robot poses at the frames used. sightings: the edges of these. built: all landmarks that were tried; the
    map holds those worth keeping. slam: what else was found out where poses were not known.
    """

    landmark_map: LandmarkMap
    trajectory: Trajectory
    sightings: Sightings
    built: Built
    slam: Slam | None = None


class BuildWatch(Protocol):
    """What looks on while a map is built."""

    def begin(self, path: Trajectory, turn_sigma: Array) -> None:
        """Take the poses (T, 3) as known while driving, and the errors (T,) rad of their turns."""

    def frame(self, t_ns: int, edges: Edges) -> None:
        """Take the edges of one image."""

    def finish(self, built: MapBuilt) -> None:
        """Take what came out."""


def build_map(
    log: RecordedLog,
    poses: str | Trajectory = TRUTH,
    config: BuildSettings | None = None,
    *,
    progress: Callable[[], None] | None = None,
    watch: BuildWatch | None = None,
    cache: Path | None = None,
    source: str = "a trajectory",
) -> MapBuilt:
    """Return the landmark map of a log. Nothing is written but the cache, where there is one.

    poses: `truth`, `odometry`, `slam`, or the robot's poses in the map; source: what these are called in the map.
    progress: is called after each image. cache: folder in which edges are kept for the next build; see `edges_of_log`.
    Raises InputError when poses are missing, the robot stands still, or nothing is seen from two sides.
    """
    config = config or BuildParameters()
    name = poses if isinstance(poses, str) else source
    known = known_poses(log, ODOMETRY if poses == SLAM else poses) if isinstance(poses, str) else poses
    inside, trajectory = sampled_at_images(log, known)
    require_motion(log, trajectory)
    exact = name not in (ODOMETRY, SLAM)
    turn_sigma = np.full(len(trajectory), KNOWN_TURN_RAD) if exact else turn_sigmas(trajectory, config.motion)
    if watch is not None:
        watch.begin(trajectory, turn_sigma)

    def step(t_ns: int, edges: Edges) -> None:
        if watch is not None:
            watch.frame(t_ns, edges)
        if progress is not None:
            progress()

    edges = edges_of_log(log, config.edges, step, cache)
    sightings = Sightings.from_edges([edges[index] for index in inside], log.camera)
    if len(sightings) == 0:
        raise InputError(
            f"expected vertical edges in the images, found none in {sightings.frames} of them", path=log.path
        )
    parameters, slam, probability = config.mapping, None, None
    if name == SLAM:
        slam = _slam(log, sightings, trajectory, config)
        trajectory = Trajectory(trajectory.t_ns, slam.poses)
        cameras, sigma, built = slam.cameras, slam.sigma, slam.built
    else:
        sigma = measured_sigma(sightings, log.camera.focal_px, parameters)
        cameras = sightings.camera_poses(log.camera, trajectory.poses)
        track = follow(sightings, cameras, turn_sigma, parameters.tracks)
        built, probability = built_along(
            cameras, sightings, sigma, track, parameters, exact=exact, far=are_far(cameras)
        )
    landmark_map = landmark_map_of(
        sightings,
        built,
        cameras,
        sigma,
        log.camera,
        parameters,
        log.name,
        f"{log.name}, poses: {name}",
        probability=probability,
    )
    require_landmarks(log, landmark_map, sightings, built, parameters)
    result = MapBuilt(landmark_map, trajectory, sightings, built, slam)
    if watch is not None:
        watch.finish(result)
    return result


def sampled_at_images(log: RecordedLog, known: Trajectory) -> tuple[NDArray[np.int64], Trajectory]:
    """Return the indices of the images within the time of the known poses, and the poses at these images."""
    t_ns = np.array([frame.t_ns for frame in log.frames], dtype=np.int64)
    inside = np.flatnonzero((t_ns >= known.t_ns[0]) & (t_ns <= known.t_ns[-1]))
    if len(inside) < _FEWEST_FRAMES:
        raise InputError(
            f"expected poses at two images at least, found poses from {known.t_ns[0]} to {known.t_ns[-1]} ns and "
            f"images from {t_ns[0]} to {t_ns[-1]} ns",
            path=log.path,
            field="--poses",
        )
    return inside, known.sampled(t_ns[inside])


def _slam(log: RecordedLog, sightings: Sightings, odometry: Trajectory, config: BuildSettings) -> Slam:
    """Return landmarks and poses, found together from edges and wheels."""
    wheels = wheels_of(log.odometry, odometry.t_ns, config.motion)
    require_association(log.path, sightings, wheels)
    return build_from_log(sightings, wheels, Prior.of(config.motion), odometry.poses[0], log.camera, config.mapping)


def built_along(
    cameras: Array,
    sightings: Sightings,
    sigma: Array,
    track: Index,
    parameters: MappingParameters,
    *,
    exact: bool,
    far: bool,
) -> tuple[Built, Array | None]:
    """Return the landmarks (L) seen from camera poses (T, 3), and how likely each exists (L,) where that is known.

    track: (S,) as edges were followed. exact: poses are known and not from odometry. far: see `are_far`. Where bearings
    are too coarse to follow an edge from image to image, a mixture of landmarks explains all of them; where images are
    too far apart, crossings of rays do.
    """
    if exact and np.median(sigma) > COARSE_RAD:
        return build_from_coarse(sightings, cameras, sigma, parameters), None
    if exact and far:
        return build_from_far_images(sightings, cameras, sigma, parameters)
    return build_from_poses(sightings, track, cameras, sigma, parameters), None
