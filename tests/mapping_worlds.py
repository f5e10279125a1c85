"""Drives through the worlds that ship with the project, and the edges that a camera would measure on them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localiser import documents, simulate
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Trajectory, between, compose
from localiser.landmarks import LandmarkMap
from localiser.mapping import Sightings, direction_of, parallax

WORLDS = Path(__file__).resolve().parent.parent / "configs" / "worlds"


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A drive: true landmarks (L), camera, true poses (T) of the images, odometry, what is visible (T, L)."""

    landmark_map: LandmarkMap
    camera: Camera
    truth: Trajectory
    odometry: Trajectory
    visible: NDArray[np.bool_]

    def edges(self, seed: int, clutter: float = 3.0) -> list[Edges]:
        """Return the edges of every image: nine of ten landmarks are found, and some edges are of nothing."""
        noise = simulate.EdgeNoise(detection_probability=0.9, clutter_per_frame=clutter)
        rng = np.random.default_rng(seed)
        return simulate.simulated_edges(
            self.landmark_map, self.camera, self.truth, rng, noise=noise, visible=self.visible
        )

    def seen_from_apart(self, edges: list[Edges], degrees: float, fewest: int = 5) -> NDArray[np.int64]:
        """Return the landmarks that the edges show in `fewest` images and from directions so far apart."""
        sightings = Sightings.from_edges(edges, self.camera)
        cameras = self.camera.pose_in_map(self.truth.poses)
        owner = np.concatenate([frame.landmark_id for frame in edges])
        seen = []
        for landmark in range(len(self.landmark_map)):
            rows = np.flatnonzero(owner == landmark)
            points = np.repeat(self.landmark_map.points[landmark : landmark + 1], len(rows), axis=0)
            heading, _ = direction_of(points, cameras[sightings.frame[rows]])
            if len(rows) >= fewest and parallax(heading) >= np.deg2rad(degrees):
                seen.append(landmark)
        return np.array(seen)


@lru_cache
def world(name: str) -> World:
    """Return the drive of a world that ships with the project."""
    model = documents.load_model(WORLDS / f"{name}.yaml", simulate.World, simulate.world_of)
    log = simulate.simulate_log(model, 0)
    landmark_map = log.scene.structure.landmark_map
    visible = np.zeros((len(log), len(landmark_map)), dtype=bool)
    for row, shown in zip(visible, log.visible, strict=True):
        row[shown.landmark] = True
    t_ns = log.drive.image_t_ns
    return World(landmark_map, log.camera, log.drive.truth.sampled(t_ns), log.drive.odometry.sampled(t_ns), visible)


def from_start(poses: Array) -> Array:
    """Return poses (T, 3) in the frame of the first."""
    return compose(np.zeros(3), between(poses[:1], poses))
