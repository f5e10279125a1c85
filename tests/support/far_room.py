"""A room, and images from all over it that are too far apart to follow an edge from one to the next."""

from dataclasses import replace

import numpy as np

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Array, robot_from_map

CAMERA = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(np.deg2rad(20.0), 0.9))
SIGMA_RAD = 1e-3


def far_poses(count: int, seed: int) -> Array:
    """Return poses (T, 3) all over a room, looking outwards."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.uniform(-np.pi, np.pi, count)])


def images(
    places: Array, looks: Array, poses: Array, seed: int, clutter: int = 8, camera: Camera = CAMERA
) -> list[Edges]:
    """Return the edges of places (L, 2) that look like `looks` (L, 2), and of other things, from poses (T, 3)."""
    rng, frames = np.random.default_rng(seed), []
    for pose in camera.pose_in_map(poses):
        level = robot_from_map(pose, places)
        bearing = np.arctan2(level[:, 0], -level[:, 1])
        seen = (np.abs(bearing) < 0.5) & (rng.random(len(places)) < 0.7)
        bearing = np.concatenate([bearing[seen], rng.uniform(-0.5, 0.5, clutter)])
        bearing += SIGMA_RAD * rng.standard_normal(len(bearing))
        grey = np.concatenate([looks[seen] + rng.normal(0, 4, (seen.sum(), 2)), rng.uniform(30, 220, (clutter, 2))])
        known = np.full(len(bearing), SIGMA_RAD)
        edges = Edges.from_columns(bearing, known, bearing, known)
        polarity = np.sign(grey[:, 1] - grey[:, 0]).astype(np.int8)
        frames.append(replace(edges, profile=np.repeat(grey, [5, 4], axis=1), polarity=polarity))
    return frames


def room(seed: int) -> tuple[Array, Array]:
    """Return 24 places on the walls of a room, and how each looks."""
    rng = np.random.default_rng(seed)
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False) + rng.uniform(-0.08, 0.08, 24)
    places = 3.0 * np.stack([np.cos(turn), np.sin(turn)], axis=-1) + rng.uniform(-0.3, 0.3, (24, 2))
    left = rng.uniform(30, 220, 24)
    return places, np.stack([left, (left + rng.uniform(50, 140, 24)) % 256], axis=-1)
