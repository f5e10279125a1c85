"""Record how a map grew, for Rerun: what each frame added to the landmarks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from localiser.app.map_build import MapBuilt
from localiser.geometry import Array, Trajectory
from localiser.mapping.sightings import per_point
from localiser.storage import ImageEvent, Log
from localiser.view.mapping import Growing, MapRecording

_KNOWN_M = 2.0  # a landmark is drawn once its place is known to this


def record(built: MapBuilt, log: Log, path: Path) -> None:
    """Write the building of a map to a Rerun recording. Raises OutputError."""
    frames = {frame.t_ns: frame for frame in log.frames}
    trajectory = built.trajectory
    before = None if built.slam is None else Trajectory(trajectory.t_ns, built.slam.before)
    recording = MapRecording(
        path, log.name, log.camera, built.landmark_map, before, images=isinstance(log.frames[0], ImageEvent)
    )
    information = _information(built, log)
    total = np.zeros((len(built.built), 2, 2))
    of, first = built.built.of, built.sightings.first
    for number, (t_ns, pose) in enumerate(zip(trajectory.t_ns, trajectory.poses, strict=True)):
        rows = slice(int(first[number]), int(first[number + 1]))
        np.add.at(total, of[rows][of[rows] >= 0], information[rows][of[rows] >= 0])
        frame = frames[int(t_ns)]
        image = frame.encoded() if isinstance(frame, ImageEvent) else None
        previous = trajectory.poses[max(number - 1, 0)]
        recording.frame(int(t_ns), pose, previous, image, built.edges[number], of[rows], _known(built, total))
    recording.close()


def _information(built: MapBuilt, log: Log) -> Array:
    """Return what each sighting (S, 2, 2) tells of its landmark's place; 0 for those of no landmark."""
    sightings, of = built.sightings, built.built.of
    cameras = log.camera.pose_in_map(built.trajectory.poses)
    jacobian = per_point(built.built.fit.points[of], cameras[sightings.frame]) / sightings.sigma[:, None]
    return np.where((of >= 0)[:, None, None], jacobian[:, :, None] * jacobian[:, None, :], 0.0)


def _known(built: MapBuilt, information: Array) -> Growing:
    cov = np.linalg.inv(information + 1e-6 * np.eye(2))
    # What the whole log leaves uncertain, no part of it knows better.
    cov = cov + built.built.cov
    known = np.linalg.eigvalsh(cov)[:, 1] < _KNOWN_M**2
    return Growing(built.built.fit.points[known], cov[known])
