"""Build one landmark map from several logs with known poses: other cameras, other days, one frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from localiser.errors import InputError
from localiser.geometry import Trajectory
from localiser.mapping.build import BuildSettings, MapBuilt, built_along, sampled_at_images
from localiser.mapping.far_images import are_far
from localiser.mapping.landmarks import measured_sigma
from localiser.mapping.log_edges import edges_of_log
from localiser.mapping.mappable import require_landmarks, require_motion
from localiser.mapping.quality import landmark_map_of
from localiser.mapping.recorded import KNOWN_TURN_RAD, TRUTH, RecordedLog, known_poses
from localiser.mapping.sightings import Index, Sightings
from localiser.mapping.tracks import follow


def build_map_together(
    logs: Sequence[RecordedLog],
    config: BuildSettings,
    *,
    progress: Callable[[], None] | None = None,
    cache: Path | None = None,
) -> MapBuilt:
    """Return one landmark map of several logs, whose true poses are in one frame.

    progress, cache: see `build_map`. The trajectory of the result is that of the first log. Raises InputError as
    `build_map` does.
    """
    parts, cameras, sigmas, first = [], [], [], None
    tracks: list[Index] = []
    count = 0
    for log in logs:
        inside, trajectory = sampled_at_images(log, known_poses(log, TRUTH))
        require_motion(log, trajectory)
        edges = edges_of_log(log, config.edges, lambda *_: progress() if progress else None, cache)
        part = Sightings.from_edges([edges[index] for index in inside], log.camera)
        if len(part) == 0:
            raise InputError("expected vertical edges in the images, found none", path=log.path)
        seen_from = part.camera_poses(log.camera, trajectory.poses)
        track = follow(part, seen_from, np.full(len(trajectory), KNOWN_TURN_RAD), config.mapping.tracks)
        parts.append(part)
        cameras.append(seen_from)
        sigmas.append(measured_sigma(part, log.camera.focal_px, config.mapping))
        tracks.append(track + count)
        count += 1 + int(track.max(initial=-1))
        first = first or Trajectory(trajectory.t_ns, trajectory.poses)
    assert first is not None
    sightings = Sightings.together(parts, [log.camera for log in logs])
    seen_from, sigma = np.concatenate(cameras), np.concatenate(sigmas)
    far = any(are_far(poses) for poses in cameras)
    built, probability = built_along(
        seen_from, sightings, sigma, np.concatenate(tracks), config.mapping, exact=True, far=far
    )
    names = " + ".join(log.name for log in logs)
    landmark_map = landmark_map_of(
        sightings,
        built,
        seen_from,
        sigma,
        logs[0].camera,
        config.mapping,
        names,
        f"{names}, poses: {TRUTH}",
        probability=probability,
    )
    require_landmarks(logs[0], landmark_map, sightings, built, config.mapping)
    return MapBuilt(landmark_map, first, sightings, built)
