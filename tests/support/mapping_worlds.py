"""Drives through the worlds that ship with the project, and the edges that a camera would measure on them."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from simulated_edges import EdgeNoise, simulated_edges

from localiser import documents, simulate
from localiser.camera import Camera
from localiser.edges import Edges
from localiser.geometry import Array, Trajectory, between, compose, wrap_angle
from localiser.landmarks import LandmarkMap
from localiser.mapping import Sightings, direction_of

WORLDS = Path(__file__).resolve().parents[2] / "configs" / "worlds"


def parallax(headings: Array) -> float:
    """Return the widest angle (rad) between headings (K,) that lie within half a turn of each other."""
    return float(np.ptp(wrap_angle(headings - np.angle(np.exp(1j * headings).mean()))))


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
        noise = EdgeNoise(detection_probability=0.9, clutter_per_frame=clutter)
        rng = np.random.default_rng(seed)
        return simulated_edges(self.landmark_map, self.camera, self.truth, rng, noise=noise, visible=self.visible)

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
    model = documents.validate(documents.load(WORLDS / f"{name}.yaml"), simulate.World, simulate.world_of)
    drive = _driven(simulate.simulated_log(model, 0))
    return replace(drive, odometry=drive.odometry.sampled(drive.truth.t_ns))


def laps(name: str, seed: int, distance_scale: float = 0.04, times: int | None = None) -> World:
    """Return a drive along a world's path, back, and along it again, with turns on the spot and wheels that are wrong.

    times: how often it is driven, by turns there and back; by default three times, through the office four.
    """
    model = documents.validate(documents.load(WORLDS / f"{name}.yaml"), simulate.World, simulate.world_of)
    there = [way.to for way in model.drive.path]
    path = list(there)
    for time in range(1, times or (4 if name == "office" else 3)):
        path += there[-2::-1] if time % 2 else there[1:]
    ways = tuple(type(model.drive.path[0])(to=point) for point in path)
    drive = model.drive.model_copy(update={"path": ways})
    wheels = model.odometry.model_copy(update={"distance_scale": distance_scale})
    return _driven(simulate.simulated_log(model.model_copy(update={"drive": drive, "odometry": wheels}), seed))


def _driven(log: simulate.SimulatedLog) -> World:
    landmark_map = log.scene.structure.landmark_map
    visible = np.zeros((len(log), len(landmark_map)), dtype=bool)
    for row, shown in zip(visible, log.visible, strict=True):
        row[shown.landmark] = True
    return World(landmark_map, log.camera, log.drive.truth.sampled(log.drive.image_t_ns), log.drive.odometry, visible)


def with_looks(edges: list[Edges], landmarks: int, seed: int) -> list[Edges]:
    """Return the edges with grey values left and right of each, that of its landmark and some noise, and polarity.

    Grey values of clutter are anything. The two sides of an edge differ by ten grey levels at least, or it were none.
    """
    rng = np.random.default_rng([seed, 1])
    grey = rng.uniform(30, 220, (landmarks, 2))
    flat = np.abs(np.diff(grey, axis=1)[:, 0]) < 20
    grey[flat, 1] = (grey[flat, 0] + 60) % 220
    looking = []
    for frame in edges:
        anything = rng.uniform(30, 220, (len(frame), 2))
        sides = np.where((frame.landmark_id >= 0)[:, None], grey[frame.landmark_id], anything)
        sides = sides + rng.normal(0, 4, sides.shape)
        polarity = np.sign(sides[:, 1] - sides[:, 0]).astype(np.int8)
        looking.append(replace(frame, profile=np.repeat(sides, [5, 4], axis=1), polarity=polarity))
    return looking


def from_start(poses: Array) -> Array:
    """Return poses (T, 3) in the frame of the first."""
    return compose(np.zeros(3), between(poses[:1], poses))
