"""Record how a map came about: for every image its edges, and the landmarks that have been seen until then."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from localiser.geometry import Trajectory
from localiser.mapping import MapBuilt
from localiser.storage import ImageEvent, Log
from localiser.view import Finished, Growing, MapFile, building_context


def record_growth(log: Log, built: MapBuilt, path: Path) -> None:
    """Write to a recording for Rerun how a map came about. Raises OutputError."""
    made, slam = built.landmark_map, built.slam
    sigma_cm = 100 * np.sqrt(np.trace(made.cov, axis1=1, axis2=2) / 2)
    text = f"{len(made)} landmarks, good to {np.median(sigma_cm):.2f} cm (median)"
    before = Trajectory(built.trajectory.t_ns, slam.before) if slam else None
    recording = MapFile(path, building_context(log.name, log.camera, built.trajectory, images=log.has_images))
    try:
        for growing in _growth(log, built):
            recording.frame(growing)
        recording.finish(Finished(made, built.trajectory, before, text))
    finally:
        recording.close()


def _growth(log: Log, built: MapBuilt) -> Iterator[Growing]:
    """Yield every image with what had been seen of the map by then; landmarks stand where they do in the end."""
    sightings, of, made = built.sightings, built.built.of, built.landmark_map
    on_map = np.full(len(built.built) + 1, -1)
    on_map[built.kept] = np.arange(len(made))
    landmark = on_map[of]
    begun = np.full(len(made), sightings.frames)
    np.minimum.at(begun, landmark[landmark >= 0], sightings.frame[landmark >= 0])
    # Numbers that grow in the order in which things were seen first; an edge of nothing is seen once.
    thing = np.where(of >= 0, of, len(built.built) + np.arange(len(of)))
    _, first, index = np.unique(thing, return_index=True, return_inverse=True)
    number = np.argsort(np.argsort(first))[index]
    image_at = {frame.t_ns: place for place, frame in enumerate(log.frames)}
    for frame, (t_ns, pose) in enumerate(zip(built.trajectory.t_ns.tolist(), built.trajectory.poses, strict=True)):
        own = slice(sightings.first[frame], sightings.first[frame + 1])
        known = np.flatnonzero(begun <= frame)
        shown = np.flatnonzero(np.isin(known, landmark[own]))
        image, edges = log.frames[image_at[t_ns]], built.edges[0][image_at[t_ns]]
        encoded = image.encoded() if isinstance(image, ImageEvent) else None
        points, cov = made.points[known], made.cov[known]
        yield Growing(t_ns, pose, encoded, edges, number[own], landmark[own] >= 0, points, cov, shown)
